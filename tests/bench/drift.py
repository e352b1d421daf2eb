"""Drift over the city twin's first 800 revolutions, radar only, beside the KISS-ICP front end on the same returns."""

from __future__ import annotations

from pathlib import Path

from common import Claim, score, table, twin
from common import run as mqslam_run

_RUNS = (("kaist01", 1), ("kaist02", 2))


def run(out: Path) -> list[Claim]:
    rows: list[list[str | float]] = []
    claims = []
    for name, seed in _RUNS:
        data = twin(name, seed)
        drift = {}
        for frontend in ("psi", "kiss_icp"):
            summary = mqslam_run(data, out / "drift", "--frontend", frontend)
            found = score(out / "drift" / "odometry.tum", data / "gt" / "poses_tum.txt")  # before loops
            drift[frontend] = found["drift_percent"]
            errors = [found["drift_percent"], found["drift_deg_per_100m"], found["ate_rmse_m"]]
            rows.append([name, str(seed), frontend, *errors, f"{summary['runtime_s']['total']:.1f}"])
        ratio = drift["psi"] / drift["kiss_icp"]
        claims.append(Claim(f"{name}: drift of the psi front end over that of KISS-ICP", ratio, most=0.5))
    table(["run, first 800", "seed", "front end", "drift [%]", "[deg/100 m]", "ATE [m]", "whole run [s]"], rows)
    return claims
