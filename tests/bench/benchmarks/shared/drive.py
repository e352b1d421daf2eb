"""A whole real drive by front end, with other sensors and without, against GPS."""

from __future__ import annotations

from pathlib import Path

import yaml
from bench.benchmark import Benchmark, Bound, Cell, Column, Row, label
from bench.measuring.commands import FRONT_ENDS, OURS, read_json, run
from bench.measuring.gps import COLUMNS, real_drive, score_drive

_ALONE, _TURNED, _PLACED = "none", "gyroscope", "gyroscope and GNSS"
_SENSORS = {_ALONE: (), _TURNED: ("--imu", "auto"), _PLACED: ("--imu", "auto", "--gnss", "auto")}
_DEFAULT = "default"
_THRESHOLDS = (60.0, 80.0, 100.0)  # of intensity; peers are a lottery on weak returns, so that each gets several chances


def _measure(out: Path) -> list[Row]:
    rows = [_measure_run(out, OURS, sensors, None) for sensors in _SENSORS]
    for name in FRONT_ENDS.values():
        rows += [_measure_run(out, name, _ALONE, threshold) for threshold in (None, *_THRESHOLDS)]
    return [row for n, row in enumerate(rows) if row not in rows[:n]]


def _measure_run(out: Path, name: str, sensors: str, threshold: float | None) -> Row:
    front_end = next(key for key, shown in FRONT_ENDS.items() if shown == name)
    shown = _DEFAULT if threshold is None else f"{threshold:g}"
    stem = "-".join([front_end, *sensors.split(), shown])
    settings = out / f"{stem}.yaml"
    settings.write_text(
        "" if threshold is None else yaml.safe_dump({"detector": {"threshold": threshold}}), encoding="utf-8"
    )
    options = ("--frontend", front_end, "--config", str(settings), *_SENSORS[sensors])
    folder = run(real_drive(), out / stem, *options)
    summary = read_json(folder / "summary.json")
    recording = summary["dataset"]
    track = folder / ("odometry.tum" if sensors == _ALONE else "trajectory.tum")
    cells: dict[str, Cell] = {"front_end": name, "sensors": sensors, "threshold": shown}
    cells |= {"scans": recording["revolutions"], **score_drive(track)}
    cells |= {"verdict": summary["verdict"]["status"], "real_time": recording["duration_s"] / summary["runtime_s"]["total"]}
    return Row(cells, judged=name == OURS)


_OURS = {"front_end": OURS, "threshold": _DEFAULT}

BENCHMARK = Benchmark(
    what="A whole real drive: 714 scans, 1.50 km. The truth is GPS, good to a metre or two. Radar alone is judged before "
    "loops, and other sensors after them. Peers get the same returns, and the intensity threshold that serves them best.",
    data="real",
    columns=(
        label("front_end", "front end"),
        label("sensors", "sensors"),
        label("threshold", "threshold"),
        Column("scans", "scans", "{:.0f}"),
        *COLUMNS,
        Column("verdict", "verdict", "{}"),
        Column("real_time", "times real time", "{:.1f}"),
    ),
    measure=_measure,
    bounds=(
        Bound("scans", _OURS, least=714),
        Bound("ate_m", {**_OURS, "sensors": _ALONE}, most=2.0),
        Bound("turn_deg_per_100m", {**_OURS, "sensors": _ALONE}, most=0.8),
        Bound("wz_rms", {**_OURS, "sensors": _ALONE}, most=0.015),
        Bound("ate_m", {**_OURS, "sensors": _TURNED}, most=1.8),
        Bound("ate_m", {**_OURS, "sensors": _PLACED}, most=1.2),
    ),
)
