"""A finished map of a radar, read from its file, whose second half lies somewhere else than the first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drives import block_drive

import mqslam
from mqslam.auditing.sweeps import place_sweeps
from mqslam.commands.result import JudgedResult
from mqslam.config import Config
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.formats.ply import MapClock, write_ply
from mqslam.psi.place import beam_of

CONFIG = Config()
DISPLACED_M = 6.0  # farther than a step is looked for around the trajectory


def audit_cloud(folder: Path, displaced_m: float, *, tracked: bool) -> JudgedResult:
    """Writes the map of a drive around a block, its second half displaced, and audits the file."""
    recording, scans = block_drive()
    truth = recording.ground_truth
    assert truth is not None
    sweeps, inside = place_sweeps(scans, truth, beam_of(CONFIG.estimator, 0.0))
    points, times = sweeps.points.copy(), sweeps.turns * sweeps.revolution_s
    points[times > times[-1] / 2.0] += displaced_m * np.array([0.6, 0.8])
    ones = np.ones(len(points))
    clock = MapClock(int(scans.stamps_us[inside[0]]), round(sweeps.revolution_s * 1e6))
    write_ply(folder / "map.ply", PointMap(points, times, ones, ones, ones.astype(np.bool_)), clock)
    trajectory: Trajectory | str = truth if tracked else "recording"
    return mqslam.audit(folder / "map.ply", folder / "audited", trajectory=trajectory)


@pytest.mark.parametrize("tracked", [True, False], ids=["with its trajectory", "without"])
def test_a_cloud_whose_second_half_is_displaced_fails_and_says_where(tmp_path: Path, tracked: bool) -> None:
    result = audit_cloud(tmp_path, DISPLACED_M, tracked=tracked)
    assert result.verdict == "fail", result.reasons
    middle_s = result.summary["dataset"]["duration_s"] / 2.0
    assert result.summary["steps"]["jumps"] == 1
    jump = result.reasons[0].removeprefix("the map jumps by ").removesuffix(" s").split(" m at ")
    assert [float(number) for number in jump] == [pytest.approx(DISPLACED_M, abs=0.1), pytest.approx(middle_s, abs=1.5)]


@pytest.mark.parametrize(
    ("tracked", "verdict"), [(True, "pass"), (False, "not judged")], ids=["with its trajectory", "without"]
)
def test_the_same_cloud_in_one_piece_does_not_jump(tmp_path: Path, tracked: bool, verdict: str) -> None:
    result = audit_cloud(tmp_path, 0.0, tracked=tracked)
    assert result.verdict == verdict, result.reasons
    assert result.summary["steps"]["jumps"] == 0
    assert result.summary["steps"]["judged"] > 0.8 * result.summary["steps"]["count"]
