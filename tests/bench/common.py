"""What the benchmarks share: where data lies, tables and claims."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SHARED = Path(__file__).resolve().parents[3] / "shared"
OXFORD = SHARED / "data" / "oxford_tiny"
_CACHE = Path(os.environ.get("MQSLAM_BENCH_CACHE", Path(tempfile.gettempdir()) / "mqslam-bench"))


class MissingData(Exception):
    """Data that this machine does not have."""


@dataclass(frozen=True, slots=True)
class Claim:
    """A measured number and the bounds it must keep.

    Args:
        what: what was measured.
        measured: the number.
        least, most: its bounds.
    """

    what: str
    measured: float
    least: float = float("-inf")
    most: float = float("inf")

    @property
    def kept(self) -> bool:
        return self.least <= self.measured <= self.most

    def __str__(self) -> str:
        bounds = [f">= {self.least:g}"] if self.least > float("-inf") else []
        bounds += [f"<= {self.most:g}"] if self.most < float("inf") else []
        verdict = "ok" if self.kept else "MISSED"
        return f"claim: {self.what} {' and '.join(bounds)}: measured {self.measured:.4g}: {verdict}"


def table(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> None:
    """Prints rows under a head, as Markdown reads them too."""
    cells = [list(head), *([c if isinstance(c, str) else f"{c:.4g}" for c in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " |" for row in cells]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    print("\n".join(lines), flush=True)


def cache() -> Path:
    """Returns the folder for generated data and results, outside the project; MQSLAM_BENCH_CACHE names another."""
    _CACHE.mkdir(parents=True, exist_ok=True)
    return _CACHE


def shared(path: Path) -> Path:
    """Returns a path of the material that the project does not ship.

    Raises:
        MissingData: it is not there.
    """
    if not path.exists():
        raise MissingData(f"{path} is not on this machine")
    return path


def twin(name: str, seed: int, frames: int | None = 800) -> Path:
    """Returns the first scans of a run of the city twin, or all; they are generated once."""
    out = cache() / f"{name}-{frames or 'all'}-seed{seed}"
    if not out.exists():
        aside = out.with_name(f".{out.name}")
        shutil.rmtree(aside, ignore_errors=True)
        script = shared(SHARED / "twin" / "make_twin.py")
        words = [name, aside, "--seed", seed, *(["--frames", frames] if frames else [])]
        subprocess.run([sys.executable, script, *map(str, words)], check=True, stdout=subprocess.DEVNULL)
        aside.rename(out)
    return out


def street(seed: int, duration_s: float) -> Path:
    """Returns a simulated drive; it is generated once."""
    from mqslam.simulator import simulate

    out = cache() / f"street-{duration_s:g}s-seed{seed}"
    if not out.exists():
        simulate(out, scene="street", duration_s=duration_s, seed=seed, movers=6, jobs=os.cpu_count() or 1)
    return out


def run(data: Path, out: Path, *options: str) -> dict[str, Any]:
    """Runs `mqslam run` without odometry and returns its summary."""
    command = Path(sys.executable).with_name("mqslam")
    words = ["run", data, "--out", out, "--odometry", "none", "--force", "--quiet", *options]
    subprocess.run([command, *map(str, words)], check=True)
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return summary


def score(track: Path, truth: Path) -> dict[str, float]:
    """Returns the errors of a trajectory, by a tool that knows nothing of the project's code."""
    words = [sys.executable, shared(SHARED / "tools" / "score_run.py"), track, truth, "--json"]
    shown = subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True)
    errors: dict[str, float] = json.loads(shown.stdout)
    return errors
