"""A planar lidar that sweeps while the robot turns: the motion is taken out where the bag states the time of each beam."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.rooms import write_turning_bag

import mqslam
from mqslam.core import se2


def measure_errors(folder: Path, *, beam_times: bool) -> tuple[float, float]:
    """Returns the largest errors [m, rad] of the poses of a run, seen from the first pose."""
    truth = write_turning_bag(folder / "drive.bag", beam_times=beam_times)
    track = mqslam.run(folder / "drive.bag", folder / "out").read_trajectory()
    true = truth.at(track.stamps_us)
    off = se2.wrapped_between(se2.between(true[0], true), se2.between(track.poses[0], track.poses))
    return float(np.hypot(off[:, 0], off[:, 1]).max()), float(np.abs(off[:, 2]).max())


def test_a_sweep_during_a_fast_turn_is_deskewed_by_the_motion(tmp_path: Path) -> None:
    for name in ("timed", "instant"):
        (tmp_path / name).mkdir()
    timed_m, timed_rad = measure_errors(tmp_path / "timed", beam_times=True)
    instant_m, instant_rad = measure_errors(tmp_path / "instant", beam_times=False)
    assert timed_m < 0.1 and timed_rad < np.radians(4.0)
    assert instant_rad > np.radians(10.0)  # the robot turns by up to 16 degrees during a sweep
    assert timed_m < 0.4 * instant_m and timed_rad < 0.3 * instant_rad
