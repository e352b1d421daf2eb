"""Offline SLAM for spinning radars and planar lidars: the best motion is the one that makes the map crispest.

    import mqslam

    result = mqslam.run("drive", "result")
    print(result.verdict, result.report)

Public names, all typed; none of them prints anything:

- `run`, `audit`, `compare` and `localise` take the path of a recording and a folder for the results, and return the results
  that they have written there.
- `batch` runs all recordings that a file lists.
- `merge` makes one map from the results of several recordings; `read_result` reads any result again from its folder.
- `RunResult`, `AuditResult`, `CompareResult`, `LocaliseResult`, `MergeResult` and `BatchResult` are the types of the results
  that these functions return; each is a `Result`, and a verdict is a `VerdictStatus`.
- `open_recording` opens a recording; `load_config` reads settings into a `Config`.
- `detect` returns the scans of a recording with their returns; `score` computes psi of a window of scans under a motion,
  as a `PsiScore`.
- `Slam` is the method: it makes the optimised map of an open recording, in memory.
- `psi_factors` and `loop_factors` return measurements and loop closures as factors for a GTSAM graph of your own; `refine`
  replaces loop closures by factors of single scans that are registered on earlier passes of the same place. They return
  `PsiFactors`, `LoopFactors` and a `RefinedGraph`.
- A `Work` holds the engine that does the computations, such as a `LocalEngine`, and the functions that get progress and
  notes; a `Runner` reports the progress of `Slam`, and keeps its results so that an interrupted run can be continued.
- `Recording` of `PolarScan`, `Scans` of `Scan` with its `Returns`, `Trajectory` and `Measurement` with its `Status` are the
  types of inputs and results; a front end of your own gets a `Context`. `MqslamError` is the base of all errors.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mqslam.execution.kernel_cache import choose_cache

if TYPE_CHECKING:  # importing a name as itself marks it as public for type checkers
    from mqslam.auditing.verdict import VerdictStatus as VerdictStatus
    from mqslam.commands.audit import audit as audit
    from mqslam.commands.batch import batch as batch
    from mqslam.commands.compare import compare as compare
    from mqslam.commands.detect import detect as detect
    from mqslam.commands.localise import localise as localise
    from mqslam.commands.merge import merge as merge
    from mqslam.commands.own_graph import LoopFactors as LoopFactors
    from mqslam.commands.own_graph import PsiFactors as PsiFactors
    from mqslam.commands.own_graph import RefinedGraph as RefinedGraph
    from mqslam.commands.own_graph import loop_factors as loop_factors
    from mqslam.commands.own_graph import psi_factors as psi_factors
    from mqslam.commands.own_graph import refine as refine
    from mqslam.commands.result import AuditResult as AuditResult
    from mqslam.commands.result import BatchResult as BatchResult
    from mqslam.commands.result import CompareResult as CompareResult
    from mqslam.commands.result import LocaliseResult as LocaliseResult
    from mqslam.commands.result import MergeResult as MergeResult
    from mqslam.commands.result import Result as Result
    from mqslam.commands.result import RunResult as RunResult
    from mqslam.commands.result import read_result as read_result
    from mqslam.commands.run import run as run
    from mqslam.commands.score import score as score
    from mqslam.commands.work import Work as Work
    from mqslam.config import Config as Config
    from mqslam.config import load_config as load_config
    from mqslam.core.frontend import Context as Context
    from mqslam.core.measurement import Measurement as Measurement
    from mqslam.core.measurement import Status as Status
    from mqslam.core.recording import PolarScan as PolarScan
    from mqslam.core.recording import Recording as Recording
    from mqslam.core.scans import Returns as Returns
    from mqslam.core.scans import Scan as Scan
    from mqslam.core.scans import Scans as Scans
    from mqslam.core.trajectory import Trajectory as Trajectory
    from mqslam.errors import MqslamError as MqslamError
    from mqslam.execution.local_engine import LocalEngine as LocalEngine
    from mqslam.execution.runner import Runner as Runner
    from mqslam.formats.recordings import open_recording as open_recording
    from mqslam.psi.published.equations import PsiScore as PsiScore
    from mqslam.slam import Slam as Slam
    from mqslam.version import __version__ as __version__

choose_cache()  # must be called before any kernel is imported

_MODULES = {
    "VerdictStatus": "auditing.verdict",
    "audit": "commands.audit",
    "batch": "commands.batch",
    "compare": "commands.compare",
    "detect": "commands.detect",
    "localise": "commands.localise",
    "merge": "commands.merge",
    "loop_factors": "commands.own_graph",
    "psi_factors": "commands.own_graph",
    "refine": "commands.own_graph",
    "LoopFactors": "commands.own_graph",
    "PsiFactors": "commands.own_graph",
    "RefinedGraph": "commands.own_graph",
    "AuditResult": "commands.result",
    "BatchResult": "commands.result",
    "CompareResult": "commands.result",
    "LocaliseResult": "commands.result",
    "MergeResult": "commands.result",
    "RunResult": "commands.result",
    "read_result": "commands.result",
    "Result": "commands.result",
    "run": "commands.run",
    "score": "commands.score",
    "Work": "commands.work",
    "Config": "config",
    "load_config": "config",
    "Context": "core.frontend",
    "Measurement": "core.measurement",
    "Status": "core.measurement",
    "Recording": "core.recording",
    "PolarScan": "core.recording",
    "Returns": "core.scans",
    "Scan": "core.scans",
    "Scans": "core.scans",
    "Trajectory": "core.trajectory",
    "MqslamError": "errors",
    "LocalEngine": "execution.local_engine",
    "Runner": "execution.runner",
    "open_recording": "formats.recordings",
    "PsiScore": "psi.published.equations",
    "Slam": "slam",
    "__version__": "version",
}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    """Returns the public object of a name. Its module is imported only on first use, so that `import mqslam` is quick.

    Raises:
        AttributeError: there is no such public name.
    """
    if name not in _MODULES:
        raise AttributeError(f"module 'mqslam' has no attribute '{name}'")
    value = getattr(import_module(f"mqslam.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
