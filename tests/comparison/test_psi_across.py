"""psi across passes in a comparison: one set of places for all rows, on which a torn map shows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from support.passes import BEAM, LANE_Y, joined, street_pass
from support.reported import audit_of

from mqslam.auditing.verdict import VerdictStatus
from mqslam.backend.loops import passes
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.refinement import find_crossings, measure_psi_across
from mqslam.comparison import comparison
from mqslam.comparison.best import Best
from mqslam.comparison.comparison import measure_rows_across
from mqslam.comparison.judgement import JudgedRow
from mqslam.comparison.rows import make_given_row
from mqslam.config import Config
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE

EARLIER = street_pass(-25.0, LANE_Y, 0.0, 1)
LATER = street_pass(-22.0, LANE_Y, 0.0, 2)
CONFIG = Config()


@pytest.fixture(scope="module", autouse=True)
def near_passes() -> Iterator[None]:
    """Lets passes follow each other so soon that those of the tests count: each is 40 m long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passes, "LEAST_PATH_M", 35.0)
        patch.setattr(comparison, "SAMPLE_M", 5.0)
        yield


def judged(name: str, scans: Scans, poses: np.ndarray) -> JudgedRow:
    nothing = PointMap(np.empty((0, 2)), *(np.empty(0) for _ in range(3)), np.empty(0, bool))
    row = make_given_row(name, Trajectory(scans.stamps_us, poses))
    return JudgedRow(row, None, None, audit_of([], [], VerdictStatus.NOT_JUDGED), None, None, None, (), nothing)


def measured(drive: TrackedRun, best: Best | None, **poses: np.ndarray) -> dict[str, float]:
    scans = Scans(tuple(drive.scans), 0, 0.25)
    rows = {name: judged(name, scans, own) for name, own in poses.items()}
    return measure_rows_across(rows, best, scans, CONFIG, BEAM, HERE)


def moved_apart(drive: TrackedRun, aside_m: float) -> np.ndarray:
    """Returns the drive's poses (N, 3) with its second pass moved aside."""
    second = np.arange(len(drive.poses)) >= len(EARLIER.times)
    return drive.poses + np.outer(second, [0.0, aside_m, 0.0])


def test_a_row_whose_passes_do_not_lie_on_each_other_has_more_psi() -> None:
    drive = joined(EARLIER, LATER)
    across = measured(drive, Best(("right",), "drift", ""), right=drive.poses, torn=moved_apart(drive, 0.5))
    assert across["torn"] > 1.5 * across["right"]


def test_it_is_that_of_a_run_at_the_same_places() -> None:
    drive = joined(EARLIER, LATER)
    crossings = find_crossings(drive, 5.0, 35.0)
    psi = measure_psi_across(drive, crossings, CONFIG.estimator, BEAM, HERE)
    assert measured(drive, None, right=drive.poses)["right"] == pytest.approx(psi, rel=1e-6)


def test_the_best_row_says_where_a_place_is_passed_twice() -> None:
    drive = joined(EARLIER, LATER)
    far = moved_apart(drive, 500.0)  # under this row the two passes are in different streets
    rows = {"far": far, "right": drive.poses}
    assert set(measured(drive, Best(("right",), "drift", ""), **rows)) == {"far", "right"}
    assert measured(drive, Best(("far",), "drift", ""), **rows) == {}


def test_there_is_none_on_a_single_pass_and_without_rows() -> None:
    assert measured(EARLIER, None, right=EARLIER.poses) == {}
    assert measured(EARLIER, None) == {}
