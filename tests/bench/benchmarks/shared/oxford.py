"""Eleven real scans without odometry, against their ground truth, by range bin and Doppler shift."""

from __future__ import annotations

from pathlib import Path

import yaml
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.commands import OURS, RIVAL, run
from bench.measuring.recordings import SHARED, shared
from bench.measuring.scorer import score

_BINS = {"0.0432 m, as published": ("--range-resolution", "0.0432"), "default": ()}
_MEASURED, _TAKEN_OUT = "measured", "none"
_DOPPLERS = {_TAKEN_OUT: 0.0, _MEASURED: None}  # [s]; None: measured by psi


def _measure(out: Path) -> list[Row]:
    data = shared(SHARED / "data" / "oxford_tiny")
    rows = [
        _measure_run(data, out, (OURS, bins, doppler), options) for bins, options in _BINS.items() for doppler in _DOPPLERS
    ]
    return [*rows, _measure_run(data, out, (RIVAL, "default", _MEASURED), ("--frontend", "kiss_icp"))]


def _measure_run(data: Path, out: Path, names: tuple[str, str, str], options: tuple[str, ...]) -> Row:
    front_end, bins, doppler = names
    stem = "-".join(word.split()[0] for word in names)
    settings = out / f"{stem}.yaml"
    settings.write_text(yaml.safe_dump({"sensor": {"doppler_beta": _DOPPLERS[doppler]}}), encoding="utf-8")
    folder = run(data, out / stem, "--config", str(settings), *options)
    errors = score(folder / "trajectory.tum", data / "gt" / "radar_odometry.csv")
    used = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))["sensor"]["doppler_beta"]
    cells = {"front_end": front_end, "bins": bins, "doppler": doppler, "shift": used}
    cells |= {"bias": errors.rpe_v_bias, "speed": errors.rpe_v_rms, "rate": errors.rpe_w_rms}
    return Row(cells, judged=(front_end, bins, doppler) == (OURS, "default", _MEASURED))


_DEFAULT = {"front_end": OURS, "bins": "default", "doppler": _MEASURED}

BENCHMARK = Benchmark(
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
    measure=_measure,
    bounds=(
        Bound("rate", _DEFAULT, most=0.006),
        Bound("speed", _DEFAULT, most=0.30),
        Bound("bias", _DEFAULT, least=-0.12, most=0.12),
    ),
)
