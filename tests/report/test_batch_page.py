from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.reported import find_faults, page_of

from mqslam.core.trajectory import Trajectory
from mqslam.report.batch_page import write_batch_report


def a_run(name: str, **changed: Any) -> dict[str, Any]:
    return {
        "name": name,
        "verdict": "pass",
        "reasons": "0 of 40 windows are torn",
        "failure": None,
        "revolutions": 240,
        "duration_s": 60.0,
        "length_m": 421.3,
        "psi_per_point_odometry": 0.5,
        "psi_per_point": 0.25,
        "matched": 0.976,
        "loops": 3,
        "ate_rmse_m": 0.0262,
        "drift_percent": 0.0319,
        "report": f"{name}/report.html",
        **changed,
    }


def a_batch() -> dict[str, Any]:
    nothing = dict.fromkeys(a_run(""), None)
    runs = [
        a_run("good"),
        a_run("bad", verdict="fail", reasons="33 of 40 windows are <torn>", length_m=2500.0, loops=0, ate_rmse_m=None),
        a_run("alone", psi_per_point_odometry=None, duration_s=20.0),
        {**nothing, "name": "gone", "failure": "no such folder"},
    ]
    counts = {"pass": 2, "warn": 0, "fail": 1, "not judged": 0, "failed": 1}
    return {"mqslam_version": "9.8.7", "counts": counts, "duration_s": 140.0, "length_m": 3342.6, "runs": runs}


def written(folder: Path) -> str:
    track = Trajectory(np.arange(5), np.arange(15.0).reshape(5, 3))
    assert write_batch_report(folder / "report.html", "runs", a_batch(), {"good": track}, (), "runs: []") == []
    return re.sub(r"\n+", "\n", page_of(folder / "report.html").text)


def test_every_run_is_told_in_words(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert "no test speaks against the map\n421 m in 1 min 0 s, 3 loops closed\n" in text
    assert "ψ per point 50 % less than before optimisation, 98 % of the points seen twice\n" in text
    assert "26 mm off (ATE, RMSE), drift of 0.0319 %" in text
    assert "33 of 40 windows are <torn>\n2.50 km in 1 min 0 s, no loop closed\n" in text and "there is none" in text
    assert "421 m in 20 s, 3 loops closed\n98 % of the points seen twice" in text
    assert "gone\nfailed: no such folder" in text


def test_the_numbers_unfold_and_leave_out_runs_that_failed(tmp_path: Path) -> None:
    written(tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    folded = re.search(r"<details class=\"card\"><summary>The same in numbers</summary>(.*?)</details>", page, re.DOTALL)
    assert folded is not None and folded[1].count('scope="row"') == 3 and "gone" not in folded[1]


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault(tmp_path: Path, scheme: str, width: int) -> None:
    written(tmp_path)
    assert find_faults(tmp_path / "report.html", scheme, width) == []
