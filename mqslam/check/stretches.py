"""Reads a few short stretches of a recording, detects their returns and tracks them; the checks use the results."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config, DetectorConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.artefacts import drop_fixed
from mqslam.detection.detector import detect
from mqslam.detection.stage import make_scans, read_polar_scans
from mqslam.errors import DataError, EstimationError
from mqslam.psi.place import Beam
from mqslam.psi.tracking.cold_start import START_SCANS
from mqslam.psi.tracking.local_map import Tuning
from mqslam.psi.tracking.tracker import Tracked, Tracker

# Number of stretches of a recording that a check reads, and number of polar scans in each stretch: enough to track a motion
# through one or two bends, and few enough to be read in a few seconds.
STRETCHES = 3
STRETCH_SCANS = 12
# Fewest motions between scans for a comparison with odometry, or for a comparison of the two orders of azimuths.
FEWEST_STEPS = 5
# Travel [m] between keyframes while the order of azimuths is checked. A wrong order shows best if a scan is compared with
# scans from other places, so keyframes lie far apart.
_KEYFRAME_M = 40.0


@dataclass(frozen=True, slots=True)
class Turn:
    """Numbers, angles and times of the azimuths that were measured in one revolution of the radar.

    Args:
        azimuths: number of azimuths.
        unmeasured: number of azimuths that are marked as not measured.
        turned: angle from the first azimuth to one usual step after the last azimuth [rad].
        step: usual step between neighbouring azimuths [rad].
        widest: widest step between neighbouring azimuths [rad].
        turn_s: duration of the revolution [s].
        span_s: time from the first azimuth to the last azimuth [s].
        late_s: time from the start of the next polar scan to the last azimuth [s]; 0 if the last azimuth is earlier.
        repeated: whether the power equals the power of the previous polar scan, byte by byte.
    """

    azimuths: int
    unmeasured: int
    turned: float
    step: float
    widest: float
    turn_s: float
    span_s: float
    late_s: float
    repeated: bool


@dataclass(frozen=True, slots=True)
class Stretch:
    """Successive polar scans without a gap.

    Args:
        scans: scans with the returns of the polar scans.
        turns: azimuths of each polar scan that could be read.
        unread: the reasons why the other polar scans could not be read; their scans hold no returns.
    """

    scans: Scans
    turns: tuple[Turn, ...]
    unread: tuple[str, ...]


def read_stretches(
    recording: Recording,
    odometry: Trajectory | None,
    detector: DetectorConfig,
    progress: Callable[[int, int], object],
    count: int | None = None,
) -> list[Stretch]:
    """Reads the stretches in which odometry's yaw rate changes most; without odometry, evenly spread stretches.

    Args:
        recording: the recording.
        odometry: odometry on the same clock, or None.
        detector: settings of the detector.
        progress: called with the number of polar scans that were read, and the number of polar scans to read.
        count: largest number of stretches to read; None reads `STRETCHES`.
    """
    spans = choose_spans(recording, odometry, count)
    total = sum(end - begin for begin, end in spans)
    returns: dict[int, Returns] = {}
    turns: dict[int, Turn] = {}
    unread: dict[int, str] = {}
    for begin, end in spans:
        before: PolarScan | None = None
        for k, polar_scan in read_polar_scans(recording, begin, end):
            if isinstance(polar_scan, DataError):
                returns[k], unread[k], before = Returns.none(), str(polar_scan), None
            else:
                returns[k] = detect(polar_scan, recording.range_resolution, detector, recording.range_offset)
                turns[k] = _describe_turn(recording, k, polar_scan, before)
                before = polar_scan
            progress(len(returns), total)
    kept = dict(zip(returns, drop_fixed(list(returns.values())), strict=True))
    return [
        Stretch(
            make_scans(recording, [kept[k] for k in range(*span)], span[0]),
            tuple(turns[k] for k in range(*span) if k in turns),
            tuple(unread[k] for k in range(*span) if k in unread),
        )
        for span in spans
    ]


def choose_spans(recording: Recording, odometry: Trajectory | None, count: int | None = None) -> list[tuple[int, int]]:
    """Chooses stretches without gaps that do not overlap, as (first polar scan, last polar scan + 1), for `read_stretches`.

    The arguments are those of `read_stretches`. If gaps leave no stretch of the usual length, all stretches are as long as
    the longest stretch without a gap.
    """
    count = STRETCHES if count is None else count
    gap_after = np.zeros(len(recording), dtype=np.int64)
    gap_after[[k for k, _ in recording.gaps()]] = 1
    gaps = np.cumsum(gap_after) - gap_after  # number of gaps before each polar scan
    size = min(STRETCH_SCANS, int(np.bincount(gaps).max()))
    begins = np.arange(len(recording) - size + 1)
    begins = begins[gaps[begins] == gaps[begins + size - 1]]
    if odometry is None or size == 1:
        even = np.linspace(0, len(begins) - 1, 2 * count + 1)[1::2]
        order = begins[np.round(even).astype(np.int64)]
    else:
        yaw_rates = odometry.mean_twists(recording.stamps_us[:-1], recording.stamps_us[1:])[:, 2]
        order = begins[np.argsort([-np.std(yaw_rates[b : b + size - 1]) for b in begins], kind="stable")]
    chosen: list[int] = []
    for begin in order.tolist():
        if len(chosen) < count and all(abs(begin - other) >= size for other in chosen):
            chosen.append(begin)
    return [(begin, begin + size) for begin in sorted(chosen)]


def _describe_turn(recording: Recording, k: int, polar_scan: PolarScan, before: PolarScan | None) -> Turn:
    """Describes the azimuths of polar scan k; `before` is the previous polar scan, or None if it was not read."""
    steps = np.abs(np.diff(polar_scan.azimuths))
    usual = float(np.median(steps)) if len(steps) else 0.0
    after = float(recording.start_times[k + 1]) if k + 1 < len(recording) else np.inf
    return Turn(
        azimuths=len(polar_scan.times),
        unmeasured=int(np.count_nonzero(~polar_scan.valid)),
        turned=float(steps.sum()) + usual,
        step=usual,
        widest=float(steps.max(initial=0.0)),
        turn_s=float(recording.turns_us[k]) * 1e-6,
        span_s=float(polar_scan.times[-1] - polar_scan.times[0]),
        late_s=max(0.0, float(polar_scan.times[-1]) - after),
        repeated=before is not None and np.array_equal(before.power, polar_scan.power),
    )


@dataclass(frozen=True, slots=True)
class Steps:
    """Motions from scan to scan (steps) as psi measures them.

    Args:
        begins_us, ends_us: (S,) stamps at which the steps begin and end [us].
        twists: (S, 3) mean twists over the steps, in the sensor's frame [m/s, m/s, rad/s].
    """

    begins_us: NDArray[np.int64]
    ends_us: NDArray[np.int64]
    twists: se2.Array

    def __len__(self) -> int:
        return len(self.begins_us)

    def of(self, track: Trajectory, shift_us: int = 0) -> se2.Array:
        """Returns a trajectory's mean twists (S, 3) [m/s, m/s, rad/s] over these steps, each step later by `shift_us`."""
        return track.mean_twists(self.begins_us + shift_us, self.ends_us + shift_us)


@dataclass(frozen=True, slots=True)
class FollowedStretches:
    """The results of tracking the stretches of a recording by psi.

    Args:
        steps: motions from scan to scan where psi converged at both, with azimuths in the stored order.
        psi: (R,) psi per point of R scans, which are all but the first `START_SCANS - 1` of each stretch that could be
            tracked; NaN for a scan without points.
        psi_backward: (R,) psi per point of the same scans if the azimuths of all scans are in the opposite order.
        shortage: a sentence for the user that explains why there are too few values, if there are too few for a check.
    """

    steps: Steps
    psi: NDArray[np.float64]
    psi_backward: NDArray[np.float64]
    shortage: str


def follow(recording: Recording, stretches: Sequence[Stretch], settings: Config, beam: Beam) -> FollowedStretches:
    """Tracks stretches by psi, with the azimuths of their scans in the stored order and in the opposite order.

    Stretches that are too short or cannot be tracked are left out.

    Args:
        recording: the recording.
        stretches: stretches of the recording that were read.
        settings: all settings.
        beam: the sensor's measurement errors.
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
            of_sensor = settings.tracker, settings.estimator, beam, stretch.scans.revolution_s
            tracker_there = Tracker(*of_sensor, tuning=spread)
            there = track_scans(stretch.scans, tracker_there)
            backward_scans = replace(stretch.scans, scans=tuple(map(_reverse, stretch.scans)))
            # a scan's psi depends on the keyframes of the map: both maps get the same scans as keyframes
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
    shortage = _explain_shortage(stretches)
    return FollowedStretches(steps, np.array(forward), np.array(backward), shortage)


def track_scans(scans: Scans, tracker: Tracker) -> list[Tracked]:
    """Tracks successive scans by psi, in the frame of the first scan; returns one result per scan.

    Args:
        scans: at least `START_SCANS` successive scans.
        tracker: a new tracker.

    Raises:
        EstimationError: the first scans hold too few returns.
    """
    first = tracker.start(scans[:START_SCANS])
    return [first, *(tracker.follow(scan) for scan in scans[1:])]


def _explain_shortage(stretches: Sequence[Stretch]) -> str:
    """Explains to the user why stretches do not suffice for a check, which needs `FEWEST_STEPS` motions in a stretch."""
    longest, needed = max((len(stretch.scans) for stretch in stretches), default=0), START_SCANS - 1 + FEWEST_STEPS
    if longest < needed:
        return f"the check needs {needed} polar scans without a gap between them; the longest such stretch has {longest}"
    return "psi could track too few polar scans"


def _reverse(scan: Scan) -> Scan:
    """Returns a scan with the same returns, but with times as if the returns had been measured in the opposite order."""
    r = scan.returns
    times = scan.t0 + scan.t1 - r.times
    order = np.argsort(times, kind="stable")
    return Scan(scan.t0, scan.t1, Returns(r.ranges[order], r.azimuths[order], times[order], r.intensities[order]))


def _psi_per_point(tracked: Tracked) -> float:
    """Returns psi per point of a tracked scan; NaN if the scan has no points."""
    points = len(tracked.evaluation.matched)
    return tracked.evaluation.psi / points if points else float("nan")
