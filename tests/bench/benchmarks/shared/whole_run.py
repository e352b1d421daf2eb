"""A whole run with everything written, by one job and by two, against KISS-ICP's odometry over the same recording."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Cell, Column, Row, label
from bench.measuring.commands import read_json, run
from bench.measuring.recordings import twin
from bench.measuring.registration import register
from bench.results import Took

from mqslam.config import Config
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording

_SEED = 1
_TWO, _ONE, _RIVAL = "mqslam, two jobs", "mqslam, one job", "KISS-ICP's odometry"
_STAGES = ("windows", "loops", "render", "check")


def _measure(out: Path) -> list[Row]:
    data = twin("kaist01", "hard", _SEED)
    rows = [_measure_run(data, out / name, name, jobs) for name, jobs in ((_TWO, 2), (_ONE, 1))]
    rows.append(_measure_rival(data))
    two = rows[0]["wall_s"]
    assert isinstance(two, float)
    for row in rows:
        wall = row["wall_s"]
        assert isinstance(wall, float)
        row["over_two"] = wall / two
    return [Row(row, judged=row["run"] == _TWO) for row in rows]


def _measure_run(data: Path, out: Path, name: str, jobs: int) -> dict[str, Cell]:
    """Returns a row for a run of the command."""
    begin = Took.now()
    summary = read_json(run(data, out, "--jobs", str(jobs)) / "summary.json")
    took = Took.now().since(begin)
    return {
        "run": name,
        "wall_s": took.wall_s,
        "processor_s": took.processor_s,
        "real_time": summary["dataset"]["duration_s"] / took.wall_s,
        **{stage: summary["runtime_s"][stage] for stage in _STAGES},
        "peak_mb": summary["peak_rss_mb"],
    }


def _measure_rival(data: Path) -> dict[str, Cell]:
    """Returns the row for reading and detecting by two jobs, and KISS-ICP scan by scan after that."""
    begin = Took.now()
    recording, config = open_recording(data), Config()
    with LocalEngine(2) as engine:
        scans, _ = detect_all(recording, config.detector, Runner(engine))
    detected = Took.now()
    register(scans)
    took = Took.now().since(begin)
    return {
        "run": _RIVAL,
        "wall_s": took.wall_s,
        "processor_s": took.processor_s,
        "real_time": len(recording) * recording.revolution_s / took.wall_s,
        "windows": Took.now().since(detected).wall_s,
        **dict.fromkeys((*_STAGES[1:], "peak_mb")),
    }


BENCHMARK = Benchmark(
    what="A drive of KAIST01 in full on an idle machine, in seconds of wall time unless the column says otherwise.",
    data="twin",
    seeds=(_SEED,),
    columns=(
        label("run", "run"),
        Column("wall_s", "all [s]", "{:.0f}"),
        Column("processor_s", "processor time [s]", "{:.0f}"),
        Column("real_time", "times real time", "{:.1f}"),
        Column("over_two", "times that of two jobs", "{:.2f}"),
        Column("windows", "tracking", "{:.0f}"),
        Column("loops", "loops", "{:.0f}"),
        Column("render", "render", "{:.0f}"),
        Column("check", "check", "{:.0f}"),
        Column("peak_mb", "largest process [MB]", "{:.0f}"),
    ),
    measure=_measure,
    bounds=(
        Bound("real_time", {"run": _TWO}, least=10.0),
        Bound("over_two", {"run": _ONE}, least=1.7),
        Bound("over_two", {"run": _RIVAL}, least=0.25),
    ),
)
