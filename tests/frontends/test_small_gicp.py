from __future__ import annotations

import sys

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError
from mqslam.frontends.small_gicp import SmallGicpFrontEnd


def context() -> Context:
    recording, _ = street_drive()
    return Context(Config(), recording.revolution_s, recording.start_us, None)


def test_generalized_icp_of_standing_points_stays_in_the_plane() -> None:
    pytest.importorskip("small_gicp", reason="small_gicp is not installed; the extra small-gicp brings it")
    recording, scans = street_drive()
    poses = np.array([motion.pose for motion in SmallGicpFrontEnd(context()).measure(scans[:12])])
    truth = recording.drive.poses(np.array([scan.t0 for scan in scans[:12]]))
    off = se2.between(se2.between(truth[:-1], truth[1:]), poses)
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.15, 0.08, 0.01])


def test_where_small_gicp_cannot_be_imported_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(ConfigError, match=r"small_gicp: small_gicp is not installed; install it with: .*\[small-gicp\]"):
        SmallGicpFrontEnd(context())
