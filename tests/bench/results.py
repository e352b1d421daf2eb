"""What a benchmark leaves: its table with all that is needed to make it again, as one JSON file."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bench.benchmark import Benchmark, Cell, Row

_DIGITS = 6  # more of a figure would only show noise


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table, of a benchmark or of the literature.

    Args:
        name: what pages call it by.
        columns: key, head and format of each.
        rows: cells by key; those of a benchmark also say whether the row is `judged`.
    """

    name: str
    columns: list[dict[str, str]]
    rows: list[dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Result(Table):
    """The result of a benchmark.

    Args:
        what, data, seeds: as in `Benchmark`.
        version: of mqslam.
        machine: the processor, the number of its cores, and Python's version.
        command: which makes the result.
        took: how long that took, with the making of recordings that were not there.
    """

    what: str
    data: str
    seeds: list[int]
    version: str
    machine: dict[str, Any]
    command: str
    took: dict[str, float]


class Took(NamedTuple):
    """The time that something took.

    Args:
        wall_s: on the clock [s].
        processor_s: of all cores, with that of the processes that it started and that have ended [s].
    """

    wall_s: float
    processor_s: float

    @classmethod
    def now(cls) -> Took:
        """Returns the time so far, of which only differences mean anything."""
        times = os.times()
        return cls(times.elapsed, times.user + times.system + times.children_user + times.children_system)

    def since(self, begin: Took) -> Took:
        """Returns the time from another one on."""
        return Took(self.wall_s - begin.wall_s, self.processor_s - begin.processor_s)


def make_result(name: str, benchmark: Benchmark, rows: list[Row], took: Took) -> Result:
    """Returns the result of a benchmark that has just been run on this machine."""
    from mqslam.version import __version__

    return Result(
        name=name,
        what=benchmark.what,
        data=benchmark.data,
        seeds=list(benchmark.seeds),
        version=__version__,
        machine={"processor": _name_processor(), "cores": os.cpu_count(), "python": platform.python_version()},
        command=f".venv/bin/python tests/bench/run.py {name}",
        took={"wall_s": round(took.wall_s), "processor_s": round(took.processor_s)},
        columns=[{"key": column.key, "head": column.head, "form": column.form} for column in benchmark.columns],
        rows=[{"judged": row.judged, **{key: _shorten(cell) for key, cell in row.cells.items()}} for row in rows],
    )


def write_result(path: Path, result: Result) -> None:
    """Writes a result as JSON; a number that is not finite is a ValueError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(asdict(result), indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def read_result(path: Path) -> Result:
    """Reads a result."""
    return Result(**json.loads(path.read_text(encoding="utf-8")))


def read_table(path: Path) -> Table:
    """Reads a table that no benchmark has made."""
    return Table(**json.loads(path.read_text(encoding="utf-8")))


def _shorten(cell: Cell) -> Cell:
    return float(f"{cell:.{_DIGITS}g}") if isinstance(cell, float) else cell


def _name_processor() -> str:
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text(encoding="utf-8").splitlines() if cpus.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()
