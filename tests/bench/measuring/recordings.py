"""The recordings that benchmarks measure: simulated by mqslam, or of the material that it does not ship.

They are made once. A simulated one carries a digest of the simulator in its name, so that it is made again when the
simulator changes.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.benchmark import MissingData

ROOT = Path(__file__).resolve().parents[3]
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


def simulate(scene: str, realism: str, seed: int, duration_s: float) -> Path:
    """Returns a simulated drive.

    Args:
        scene: of `mqslam simulate`.
        realism: `kind` or `hard`.
        seed: of the scene and of the noise.
        duration_s: how long the drive is [s].
    """
    out = cache() / f"{scene}-{realism}-{duration_s:g}s-seed{seed}-{_digest_simulator()}"
    options = {"scene": scene, "realism": realism, "duration": f"{duration_s:g}", "seed": str(seed)}
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    return _make([MQSLAM, "simulate"], [*words, "--quiet"], out)


def twin(
    name: str,
    world: str,
    seed: int,
    frames: int | None = None,
    start: int = 0,
    data: Path | None = None,
    movers: int | None = None,
) -> Path:
    """Returns some scans of a run of the city twin, or all.

    Args:
        name: of the run.
        world: `kind` or `hard`.
        seed: of vehicles, noise and fluctuation.
        frames: number of scans; None takes all.
        start: the first of them.
        data: folder with the maps of other worlds, or None for the twin's own.
        movers: number of moving vehicles of the kind world, or None for the usual one.

    Raises:
        MissingData: the twin is not on this machine.
    """
    script = shared(SHARED / "twin" / "make_twin.py")
    words = ["--world", world, "--seed", str(seed), *(["--frames", str(frames)] if frames else [])]
    words += ["--start", str(start)] if start else []
    words += ["--data", str(data)] if data else []
    words += [] if movers is None else ["--movers", str(movers)]
    scans = f"{frames or 'all'}{f'-from{start}' if start else ''}"
    return _make([Path(sys.executable), script, name], words, cache() / f"twin-{name}-{world}-{scans}-seed{seed}")


def draw_worlds() -> Path:
    """Returns a folder with the maps of difficult worlds: a tunnel, and blocks whose streets repeat.

    Raises:
        MissingData: the twin is not on this machine.
    """
    return _make([Path(sys.executable), shared(SHARED / "twin" / "worlds.py")], [], cache() / "worlds")


def shared(path: Path) -> Path:
    """Returns a path of the material that the project does not ship.

    Raises:
        MissingData: it is not there.
    """
    if not path.exists():
        raise MissingData(f"{path} is not on this machine")
    return path


def _make(begin: list[Path | str], options: list[str], out: Path) -> Path:
    """Makes a recording by a command, whole or not at all, unless it is there or another process has made it meanwhile."""
    if not out.exists():
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as scratch:
            made = Path(scratch, out.name)
            subprocess.run([*begin, made, *options], check=True, stdout=subprocess.DEVNULL)
            if not out.exists():
                made.rename(out)
    return out


def _digest_simulator() -> str:
    """Returns a digest of the simulator's source."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "mqslam" / "simulator").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]
