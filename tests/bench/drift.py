"""Drift over the city twin's first 800 scans, radar only, of all front ends on the same returns."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from common import Claim, score, table, twin

_RUNS = (("kaist01", 1), ("kaist02", 2))
_FRONT_ENDS = ("psi", "kiss_icp", "open3d_icp")


def run(out: Path) -> list[Claim]:
    rows: list[list[str | float]] = []
    claims = []
    for name, seed in _RUNS:
        data = twin(name, seed)
        compared = out / "compare" / name
        command = Path(sys.executable).with_name("mqslam")
        words = ["compare", data, "--out", compared, "--frontends", ",".join(_FRONT_ENDS), "--odometry", "none"]
        subprocess.run([command, *map(str, words), "--odometry-only", "--force", "--quiet"], check=True)
        judged = {row["name"]: row for row in json.loads((compared / "compare.json").read_text(encoding="utf-8"))["rows"]}
        for frontend in _FRONT_ENDS:
            own = score(compared / frontend / "trajectory.tum", data / "gt" / "poses_tum.txt")
            errors = [own[key] for key in ("drift_percent", "drift_deg_per_100m", "ate_rmse_m", "rpe_v_rms")]
            row = judged[frontend]
            rows.append(
                [
                    name,
                    frontend,
                    *errors,
                    row["inflation"],
                    f"{row['windows_torn']:.1%}",
                    row["psi_per_point"],
                    f"{row['ms_per_revolution']:.0f}",
                    f"{row['peak_rss_mb']:.0f}",
                ]
            )
        psi, kiss = (judged[frontend]["drift_percent"] for frontend in _FRONT_ENDS[:2])
        claims += [
            Claim(f"{name}: drift of the psi front end over that of KISS-ICP", psi / kiss, most=1.0),
            Claim(f"{name}: drift of the KISS-ICP front end [%]", kiss, most=0.4),
        ]
    table(
        [
            "first 800 of",
            "front end",
            "drift [%]",
            "[deg/100 m]",
            "ATE [m]",
            "speed error [m/s]",
            "inflation",
            "windows torn",
            "psi per point",
            "[ms/rev]",
            "[MB]",
        ],
        rows,
    )
    return claims
