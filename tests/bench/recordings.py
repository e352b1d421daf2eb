"""The recordings that benchmarks measure: simulated, or of the material that mqslam does not ship.

They are made once. A simulated one carries a digest of what simulates it in its name, so that it is made again when that
changes.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from bench.benchmark import MissingData
from worlds.writing import simulate_hard

from mqslam.simulator import SensorModel
from mqslam.simulator import simulate as simulate_kind
from mqslam.simulator.write import COARSE_SENSOR

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
MQSLAM = Path(sys.executable).with_name("mqslam")
TRUTH = Path("gt") / "poses_tum.txt"
"""Where a recording keeps its ground truth."""
_CITY_S, _SHORT_S = 250.0, 60.0
_CACHE = Path(os.environ.get("MQSLAM_BENCH_CACHE", Path(tempfile.gettempdir()) / "mqslam-bench"))


def cache() -> Path:
    """Returns the folder for generated data and results, outside the project; MQSLAM_BENCH_CACHE names another."""
    _CACHE.mkdir(parents=True, exist_ok=True)
    return _CACHE


def simulate_city(world: str, seed: int) -> Path:
    """Returns a drive of about two kilometres through the city of a seed, in the `kind` or the `hard` world."""
    return simulate("city", world, seed, _CITY_S)


def simulate_short_city(world: str, seed: int) -> Path:
    """Returns a drive of a minute through the city of a seed, in the `kind` or the `hard` world."""
    return simulate("city", world, seed, _SHORT_S)


def simulate(scene: str, world: str, seed: int, duration_s: float, sensor: SensorModel = COARSE_SENSOR) -> Path:
    """Returns a simulated drive.

    Args:
        scene: of `mqslam simulate`, or `queue` of the hard world.
        world: `kind` or `hard`.
        seed: of the scene and of the noise.
        duration_s: how long the drive is [s].
        sensor: the radar; its range offset and Doppler shift are part of the recording's name.
    """
    write = simulate_hard if world == "hard" else simulate_kind
    errors = "" if sensor == COARSE_SENSOR else f"-offset{sensor.range_offset:g}-shift{sensor.doppler_beta:g}"
    out = cache() / f"{scene}-{world}-{duration_s:g}s-seed{seed}{errors}-{_digest_simulator(world)}"
    return _make(partial(write, scene=scene, seed=seed, duration_s=duration_s, sensor=sensor, jobs=os.cpu_count() or 1), out)


def twin(
    name: str, world: str, seed: int, frames: int | None = None, start: int = 0, options: Sequence[object] = ()
) -> Path:
    """Returns some scans of a run of the city twin, or all.

    Args:
        name: of the run.
        world: `kind` or `hard`.
        seed: of vehicles, noise and fluctuation.
        frames: number of scans; None takes all.
        start: the first of them.
        options: others of the program that makes the twin.

    Raises:
        MissingData: the twin is not on this machine.
    """
    script = shared(SHARED / "twin" / "make_twin.py")
    words = ["--world", world, "--seed", seed, *(["--frames", frames] if frames else [])]
    words += [*(["--start", start] if start else []), *options]
    scans = f"{frames or 'all'}{f'-from{start}' if start else ''}"
    return _make(_call(script, name, options=words), cache() / f"twin-{name}-{world}-{scans}-seed{seed}")


def repeating_twin(name: str, seed: int) -> Path:
    """Returns a drive of the kind world along streets that repeat, `block8` or `block12`, without traffic.

    Raises:
        MissingData: the twin is not on this machine.
    """
    maps = _make(_call(shared(SHARED / "twin" / "worlds.py")), cache() / "worlds")
    return twin(name, "kind", seed, options=("--data", maps, "--movers", 0))


def shared(path: Path) -> Path:
    """Returns a path of the material that the project does not ship.

    Raises:
        MissingData: it is not there.
    """
    if not path.exists():
        raise MissingData(f"{path} is not on this machine")
    return path


def _call(script: Path, *words: str, options: Sequence[object] = ()) -> Callable[[Path], object]:
    """Returns a function that calls a script with some words, the folder to make, and options."""
    return lambda out: subprocess.run(
        [sys.executable, script, *words, out, *map(str, options)], check=True, stdout=subprocess.DEVNULL
    )


def _make(make: Callable[[Path], object], out: Path) -> Path:
    """Makes a recording, whole or not at all, unless it is there or another process has made it meanwhile."""
    if not out.exists():
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as scratch:
            made = Path(scratch, out.name)
            make(made)
            if not out.exists():
                made.rename(out)
    return out


def _digest_simulator(world: str) -> str:
    """Returns a digest of the source of the simulator, and of the hard world for a drive through that."""
    digest = hashlib.sha256()
    folders = [ROOT / "mqslam" / "simulator", *([ROOT / "tests" / "worlds" / "hard"] if world == "hard" else [])]
    for path in (path for folder in folders for path in sorted(folder.rglob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]
