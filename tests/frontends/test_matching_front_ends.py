"""What the front ends that match scans have in common: psi, KISS-ICP, Open3D and small_gicp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.drives import find_errors, street_drive

from mqslam.config import Config
from mqslam.core import frontend
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError

TWO_SCANS = {
    "psi": [0.06, 0.03, 0.005],
    "kiss_icp": [0.4, 0.2, 0.02],
    "open3d_icp": [0.4, 0.2, 0.02],
    "small_gicp": [0.4, 0.2, 0.02],
}


@pytest.fixture(params=TWO_SCANS)
def name(request: pytest.FixtureRequest) -> str:
    if request.param in ("open3d_icp", "small_gicp"):
        pytest.importorskip(request.param.removesuffix("_icp"), exc_type=ImportError)
    return str(request.param)


def measure(name: str, scans: Sequence[Scan]) -> list[Measurement]:
    recording = street_drive()[0]
    return list(frontend.load(name)(Context(Config(), recording.revolution_s, recording.start_us, None)).measure(scans))


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_scans_hold_no_motion(name: str, count: int) -> None:
    with pytest.raises(EstimationError, match="at least two"):
        measure(name, street_drive()[1][:count])


def test_two_scans_are_enough(name: str) -> None:
    recording, scans = street_drive()
    np.testing.assert_array_less(np.abs(find_errors(recording, measure(name, scans[:2]))[0]), TWO_SCANS[name])


def test_the_same_scans_give_the_same_motions(name: str) -> None:
    scans = street_drive()[1][:15]
    for a, b in zip(measure(name, scans), measure(name, scans), strict=True):
        for field in ("pose", "covariance", "psi"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
