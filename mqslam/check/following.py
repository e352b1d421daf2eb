"""The motion through the stretches of a recording as psi finds it, with the azimuths as they are and in the other order."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.check.stretches import Stretch
from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.recording import Recording
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.psi.place import Beam
from mqslam.psi.tracking.cold_start import START_SCANS
from mqslam.psi.tracking.local_map import Tuning
from mqslam.psi.tracking.tracker import Tracked, Tracker

# Least number of motions between scans for a comparison with odometry, or of the two orders of azimuths.
FEWEST_STEPS = 5
# Travel [m] between keyframes while the order of azimuths is checked. A wrong order shows against what was seen from
# elsewhere, so that keyframes lie far apart.
_KEYFRAME_M = 40.0


@dataclass(frozen=True, slots=True)
class Steps:
    """Motion from scan to scan as psi finds it.

    Args:
        begins_us, ends_us: (S,) int64 [us], when the steps begin and end.
        twists: (S, 3) their mean twists [m/s, m/s, rad/s].
    """

    begins_us: NDArray[np.int64]
    ends_us: NDArray[np.int64]
    twists: se2.Array

    def __len__(self) -> int:
        return len(self.begins_us)

    def of(self, track: Trajectory, shift_us: int = 0) -> se2.Array:
        """Returns the mean twists (S, 3) of a trajectory over the same steps, taken later by a shift [us]."""
        return track.mean_twists(self.begins_us + shift_us, self.ends_us + shift_us)


@dataclass(frozen=True, slots=True)
class FollowedStretches:
    """The stretches of a recording as psi follows them.

    Args:
        steps: motions that psi found.
        psi: (R,) psi per point of the scans.
        psi_backward: (R,) the same with the azimuths of every scan taken in the opposite order.
        shortage: why there is too little to tell from, for a check that finds too little.
    """

    steps: Steps
    psi: NDArray[np.float64]
    psi_backward: NDArray[np.float64]
    shortage: str


def follow(
    recording: Recording,
    stretches: Sequence[Stretch],
    tracker: TrackerConfig,
    estimator: EstimatorConfig,
    beam: Beam,
) -> FollowedStretches:
    """Tracks the stretches by psi, as they are and with their azimuths in the opposite order.

    Args:
        recording: the recording.
        stretches: those parts of it that were read.
        tracker: settings of the tracker.
        estimator: settings of the score.
        beam: the sensor's errors.
    """
    spread = Tuning(keyframe_m=_KEYFRAME_M)
    edges: list[tuple[float, float]] = []
    twists: list[se2.Array] = []
    forward: list[float] = []
    backward: list[float] = []
    for stretch in stretches:
        if len(stretch.scans) < START_SCANS:
            continue
        try:
            of_sensor = tracker, estimator, beam, stretch.scans.revolution_s
            tracker_there = Tracker(*of_sensor, tuning=spread)
            there = track_scans(stretch.scans, tracker_there)
            backward_scans = replace(stretch.scans, scans=tuple(map(_reverse, stretch.scans)))
            # a scan's psi depends on how full the map is: both maps take the same scans
            back = track_scans(backward_scans, Tracker(*of_sensor, tracker_there.keyframes, spread))
        except EstimationError:
            continue
        for a, b in itertools.pairwise(there):
            if a.status is b.status is Status.CONVERGED:
                edges.append((a.t0, b.t0))
                twists.append(se2.log(se2.wrapped_between(a.pose, b.pose)) / (b.t0 - a.t0))
        for one, two in zip(there[START_SCANS - 1 :], back[START_SCANS - 1 :], strict=True):
            forward.append(_psi_per_point(one))
            backward.append(_psi_per_point(two))
    stamps = recording.start_us + np.round(np.array(edges).reshape(-1, 2) * 1e6).astype(np.int64)
    steps = Steps(stamps[:, 0], stamps[:, 1], np.array(twists).reshape(-1, 3))
    return FollowedStretches(
        steps,
        np.array(forward),
        np.array(backward),
        _explain_shortage(stretches, START_SCANS - 1 + FEWEST_STEPS),
    )


def track_scans(scans: Scans, tracker: Tracker) -> list[Tracked]:
    """Returns successive scans as psi tracks them, in the frame of the first.

    Args:
        scans: at least as many as a track starts with.
        tracker: a new one.

    Raises:
        EstimationError: a start that holds too few returns.
    """
    first = tracker.start(scans[:START_SCANS])
    return [first, *(tracker.follow(scan) for scan in scans[1:])]


def _explain_shortage(stretches: Sequence[Stretch], needed: int) -> str:
    """Returns why the stretches, of which one should hold so many polar scans, hold too little to tell from."""
    longest = max((len(stretch.scans) for stretch in stretches), default=0)
    if longest < needed:
        return f"it takes {needed} polar scans without a gap to tell, and there are no more than {longest}"
    return "too few polar scans could be followed"


def _reverse(scan: Scan) -> Scan:
    """Returns the same returns as if they had been measured in the opposite order."""
    r = scan.returns
    times = scan.t0 + scan.t1 - r.times
    order = np.argsort(times, kind="stable")
    return Scan(scan.t0, scan.t1, Returns(r.ranges[order], r.azimuths[order], times[order], r.intensities[order]))


def _psi_per_point(tracked: Tracked) -> float:
    """Returns psi per point; NaN where there are no points or the track was lost."""
    points = len(tracked.evaluation.matched)
    return tracked.evaluation.psi / points if points else float("nan")
