"""Real radar against its ground truth: a whole drive against GPS, and eleven scans."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import yaml
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import FRONT_ENDS, OURS, RIVAL, read_json, run
from bench.recordings import SHARED, shared
from bench.scorer import score

_ALONE, _TURNED, _PLACED = "none", "gyroscope", "gyroscope and GNSS"
_SENSORS = {_ALONE: (), _TURNED: ("--imu", "auto"), _PLACED: ("--imu", "auto", "--gnss", "auto")}
_DEFAULT = "default"
_THRESHOLDS = (60.0, 80.0, 100.0)  # of intensity; peers are a lottery on weak returns, so that each gets several chances


def real_drive() -> Path:
    """Returns the folder of a whole real drive whose truth is GPS.

    Raises:
        MissingData: it is not on this machine.
    """
    return shared(SHARED / "data" / "radiate_1533")


def score_drive(trajectory: Path) -> dict[str, float]:
    """Returns the figures of a trajectory of the real drive, a TUM file, as the judge of shared material scores them."""
    judge, truth = shared(SHARED / "tools" / "score_drive.py"), real_drive() / "truth.csv"
    words = [sys.executable, str(judge), str(trajectory), str(truth), "--json"]
    figures: dict[str, float] = json.loads(subprocess.run(words, capture_output=True, check=True, text=True).stdout)
    return figures


def _measure_drive(out: Path) -> list[Row]:
    ours = next(iter(FRONT_ENDS))
    ways = dict.fromkeys((ours, sensors, None) for sensors in _SENSORS)
    ways |= dict.fromkeys((name, _ALONE, threshold) for name in FRONT_ENDS for threshold in (None, *_THRESHOLDS))
    return [_measure_run(out, *way) for way in ways]


def _measure_run(out: Path, front_end: str, sensors: str, threshold: float | None) -> Row:
    shown = _DEFAULT if threshold is None else f"{threshold:g}"
    stem = "-".join([front_end, *sensors.split(), shown])
    settings = {} if threshold is None else {"detector": {"threshold": threshold}}
    folder = run(real_drive(), out / stem, *_configure(out, stem, settings), "--frontend", front_end, *_SENSORS[sensors])
    summary = read_json(folder / "summary.json")
    recording = summary["dataset"]
    track = folder / ("odometry.tum" if sensors == _ALONE else "trajectory.tum")
    cells: dict[str, Cell] = {"front_end": FRONT_ENDS[front_end], "sensors": sensors, "threshold": shown}
    cells |= {"scans": recording["revolutions"], **score_drive(track)}
    cells |= {"verdict": summary["verdict"]["status"], "real_time": recording["duration_s"] / summary["runtime_s"]["total"]}
    return Row(cells, judged=cells["front_end"] == OURS)


def _configure(out: Path, stem: str, settings: dict[str, dict[str, float | None]]) -> tuple[str, str]:
    """Writes a file of settings, and returns the option that names it."""
    path = out / f"{stem}.yaml"
    path.write_text(yaml.safe_dump(settings) if settings else "", encoding="utf-8")
    return "--config", str(path)


_BINS = {"0.0432 m, as published": ("--range-resolution", "0.0432"), _DEFAULT: ()}
_MEASURED = "measured"
_DOPPLERS = {"none": 0.0, _MEASURED: None}  # [s]; None: measured by psi


def _measure_oxford(out: Path) -> list[Row]:
    data = shared(SHARED / "data" / "oxford_tiny")
    ways = [(OURS, bins, doppler, options) for bins, options in _BINS.items() for doppler in _DOPPLERS]
    rows = []
    for front_end, bins, doppler, options in (*ways, (RIVAL, _DEFAULT, _MEASURED, ("--frontend", "kiss_icp"))):
        stem = "-".join(word.split()[0] for word in (front_end, bins, doppler))
        settings = _configure(out, stem, {"sensor": {"doppler_beta": _DOPPLERS[doppler]}})
        folder = run(data, out / stem, *settings, *options)
        errors = score(folder / "trajectory.tum", data / "gt" / "radar_odometry.csv")
        used = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))["sensor"]["doppler_beta"]
        cells = {"front_end": front_end, "bins": bins, "doppler": doppler, "shift": used}
        cells |= {"bias": errors.rpe_v_bias, "speed": errors.rpe_v_rms, "rate": errors.rpe_w_rms}
        rows.append(Row(cells, judged=(front_end, bins, doppler) == (OURS, _DEFAULT, _MEASURED)))
    return rows


_OUR_DRIVE = {"front_end": OURS, "threshold": _DEFAULT}
_OUR_SCANS = {"front_end": OURS, "bins": _DEFAULT, "doppler": _MEASURED}

BENCHMARKS = {
    "drive": Benchmark(
        study=True,
        what="A whole real drive: 714 scans, 1.50 km. The truth is GPS, good to a metre or two. Radar alone is judged "
        "before loops, and other sensors after them. Peers get the same returns, and the intensity threshold that serves "
        "them best.",
        data="real",
        columns=(
            label("front_end", "front end"),
            label("sensors", "sensors"),
            label("threshold", "threshold"),
            Column("scans", "scans", "{:.0f}"),
            Column("ate_m", "ATE [m]", "{:.2f}", Goal.LOW),
            Column("bend_200_m", "bend over 200 m [m]", "{:.2f}", Goal.LOW),
            Column("bend_400_m", "over 400 m [m]", "{:.2f}", Goal.LOW),
            Column("turn_deg_per_100m", "turn [deg/100 m]", "{:.2f}", Goal.LOW),
            Column("wz_rms", "yaw rate RMS [rad/s]", "{:.4f}", Goal.LOW),
            Column("scale_percent", "scale [%]", "{:+.2f}"),
            Column("verdict", "verdict", "{}"),
            Column("real_time", "times real time", "{:.1f}"),
        ),
        measure=_measure_drive,
        bounds=(
            Bound("scans", _OUR_DRIVE, least=714),
            Bound("ate_m", {**_OUR_DRIVE, "sensors": _ALONE}, most=2.0),
            Bound("turn_deg_per_100m", {**_OUR_DRIVE, "sensors": _ALONE}, most=0.8),
            Bound("wz_rms", {**_OUR_DRIVE, "sensors": _ALONE}, most=0.015),
            Bound("ate_m", {**_OUR_DRIVE, "sensors": _TURNED}, most=1.8),
            Bound("ate_m", {**_OUR_DRIVE, "sensors": _PLACED}, most=1.2),
        ),
    ),
    "oxford": Benchmark(
        what="Ten steps of a real radar; the ground truth's own noise is about 0.15 m/s.",
        data="real",
        columns=(
            label("front_end", "front end"),
            label("bins", "range bin"),
            label("doppler", "Doppler shift"),
            Column("shift", "[s]", "{:.4f}"),
            Column("bias", "v bias [m/s]", "{:+.3f}"),
            Column("speed", "v RMS [m/s]", "{:.3f}", Goal.LOW),
            Column("rate", "omega RMS [rad/s]", "{:.5f}", Goal.LOW),
        ),
        measure=_measure_oxford,
        bounds=(
            Bound("rate", _OUR_SCANS, most=0.006),
            Bound("speed", _OUR_SCANS, most=0.30),
            Bound("bias", _OUR_SCANS, least=-0.12, most=0.12),
        ),
    ),
}
