"""Offline radar SLAM in which the measurement is map quality.

    import mqslam

    result = mqslam.run("drive", "result")
    print(result.verdict, result.report)

Public names, all typed and silent:

- `run`, `audit`, `compare`, `localise` take a recording's path and a folder for the results, and return what they have left
  there.
- `merge` takes the results of several recordings to one map.
- `open_recording` opens a recording; `load_config` reads settings into a `Config`.
- `Slam` is the method: it takes an open recording to its optimised map, in memory.
- `psi_factors`, `loop_factors` and `refine` return measurements, loop closures and single scans among earlier passes as
  factors for a GTSAM graph of your own.
- `Work`, `Runner` and `LocalEngine` say where work is done and who is told about it.
- `Trajectory`, `Measurement` are what goes in and comes out; `MqslamError` is the base of all errors.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mqslam.execution.kernel_cache import choose_cache

if TYPE_CHECKING:
    from mqslam.commands.audit import audit
    from mqslam.commands.compare import compare
    from mqslam.commands.localise import localise
    from mqslam.commands.merge import merge
    from mqslam.commands.own_graph import loop_factors, psi_factors, refine
    from mqslam.commands.run import run
    from mqslam.commands.work import Work
    from mqslam.config import Config, load_config
    from mqslam.core.measurement import Measurement
    from mqslam.core.trajectory import Trajectory
    from mqslam.errors import MqslamError
    from mqslam.execution.local_engine import LocalEngine
    from mqslam.execution.runner import Runner
    from mqslam.formats.recordings import open_recording
    from mqslam.slam import Slam
    from mqslam.version import __version__

__all__ = [
    "Config",
    "LocalEngine",
    "Measurement",
    "MqslamError",
    "Runner",
    "Slam",
    "Trajectory",
    "Work",
    "__version__",
    "audit",
    "compare",
    "load_config",
    "localise",
    "loop_factors",
    "merge",
    "open_recording",
    "psi_factors",
    "refine",
    "run",
]

choose_cache()  # before any kernel is imported

_MODULES = {
    "Config": "config",
    "LocalEngine": "execution.local_engine",
    "Measurement": "core.measurement",
    "MqslamError": "errors",
    "Runner": "execution.runner",
    "Slam": "slam",
    "Trajectory": "core.trajectory",
    "Work": "commands.work",
    "__version__": "version",
    "audit": "commands.audit",
    "compare": "commands.compare",
    "load_config": "config",
    "localise": "commands.localise",
    "loop_factors": "commands.own_graph",
    "merge": "commands.merge",
    "open_recording": "formats.recordings",
    "psi_factors": "commands.own_graph",
    "refine": "commands.own_graph",
    "run": "commands.run",
}


def __getattr__(name: str) -> Any:
    """Returns a public name, and imports its module only now: `import mqslam` alone is to be quick."""
    if name not in _MODULES:
        raise AttributeError(f"module 'mqslam' has no attribute '{name}'")
    value = getattr(import_module(f"mqslam.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
