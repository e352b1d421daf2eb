from __future__ import annotations

from itertools import pairwise

import numpy as np
from drives import street_drive

from mqslam import se2
from mqslam.config import Config
from mqslam.frontend import Context
from mqslam.frontends.kiss_icp import KissIcpFrontEnd
from mqslam.measurement import RelativeMotion


def measured() -> list[RelativeMotion]:
    stream, windows = street_drive()
    return list(KissIcpFrontEnd(Context(Config(), stream.period_s, stream.start_us, None)).measure(windows))


def test_once_it_has_caught_up_the_motions_are_roughly_those_driven() -> None:
    stream, windows = street_drive()
    assert stream.ground_truth is not None
    motions, truth = measured(), stream.ground_truth.poses
    assert [(m.t0, m.t1) for m in motions] == [(a.t0, b.t0) for a, b in pairwise(windows)]
    off = se2.between(se2.between(truth[:-1], truth[1:]), np.array([m.pose for m in motions]))[8:]
    np.testing.assert_array_less(np.median(np.abs(off), axis=0), [0.2, 0.05, 0.01])
    np.testing.assert_array_less(np.abs(off).max(axis=0), [0.5, 0.25, 0.08])


def test_it_says_how_many_returns_it_took_and_how_sure_it_is_by_its_settings() -> None:
    _, windows = street_drive()
    settings = Config().kiss_icp
    for motion, window in zip(measured(), windows[1:], strict=True):
        assert motion.points == len(window.returns)
        np.testing.assert_allclose(np.sqrt(np.diag(motion.covariance)), [settings.sigma_m] * 2 + [settings.sigma_yaw])


def test_the_same_windows_give_the_same_motions() -> None:
    for a, b in zip(measured(), measured(), strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
