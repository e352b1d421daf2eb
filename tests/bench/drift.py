"""Drift over the city twin's first 800 revolutions, radar only, beside the KISS-ICP front end on the same returns."""

from __future__ import annotations

from pathlib import Path

from common import Claim, run_and_score, table, twin

_RUNS = (("kaist01", 1), ("kaist02", 2))


def run(out: Path) -> list[Claim]:
    rows: list[list[str | float]] = []
    claims = []
    for name, seed in _RUNS:
        data = twin(name, seed)
        drift = {}
        for frontend in ("psi", "kiss_icp"):
            found = run_and_score(data, data / "gt" / "poses_tum.txt", out / "drift", "--frontend", frontend)
            drift[frontend] = found["drift_percent"]
            errors = [drift[frontend], found["drift_deg_per_100m"], found["ate_rmse_m"]]
            rows.append([name, str(seed), frontend, *errors, f"{found['summary']['runtime_s']['total']:.1f}"])
        claims.append(Claim(f"{name}: drift of psi over that of KISS-ICP", drift["psi"] / drift["kiss_icp"], most=0.5))
    table(["run, first 800", "seed", "front end", "drift [%]", "[deg/100 m]", "ATE [m]", "whole run [s]"], rows)
    return claims
