"""Odometry by psi over a running map: each scan is matched to the last keyframes.

The state of a scan (see `mqslam.psi.tracking.dynamics`) is found by minimising psi plus the state predicted from the
scan before. The start pose must be free: were it fixed where the last scan ended, errors of successive scans would
alternate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import LONGEST_COAST_S
from mqslam.core.scans import Scan
from mqslam.errors import FewReturnsError
from mqslam.psi.covariance import estimate_covariance
from mqslam.psi.estimator import Evaluation
from mqslam.psi.gaussians import fuse, invert_information
from mqslam.psi.minimiser import Minimum, annealed_scale, final_scale
from mqslam.psi.observability import find_weak_directions, loosen
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.tracking.correlate import PIXEL
from mqslam.psi.tracking.dynamics import (
    MOTION,
    POSE,
    SIZE,
    TOLERANCES,
    TWIST,
    State,
    coast,
    hold_directions,
    initial_state,
    know_motion,
    longest_step,
    predict,
    spans,
    take_motion,
)
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.start import FirstMotion, find_first_motion, matched_share, overlaps

FEWEST = 5 * SIZE  # returns that a scan needs to be matched: five for each number of its state
_LEAST_SPREAD = 0.2  # sector that the returns of a scan must span [rad]: a single bearing shows one pattern of ranges
PREDICTION_GAIN = 0.1  # variance left of psi's own once the state before has smoothed it; measured, see BENCHMARKS.md
_USUAL_MEMORY = 0.95  # the usual matched share forgets with this factor per scan


@dataclass(frozen=True, slots=True)
class Tracked:
    """One scan, matched.

    Args:
        t0: its start [s].
        state: (8,) as in `mqslam.psi.tracking.dynamics`.
        covariance: (6, 6) of start pose and twist, given the map that the scan is in, from psi's curvature.
        evaluation: psi at the minimum.
        status: how far it can be trusted.
        begins_map: whether a new map begins with it.
        arrival: (3, 3) covariance of its start pose that only the step to it has, behind a gap or a loss; else None.
        earlier: (3,) start pose as it was first measured, where it was measured again; else None.
    """

    t0: float
    state: se2.Array
    covariance: NDArray[np.float64]
    evaluation: Evaluation
    status: Status
    begins_map: bool = False
    arrival: NDArray[np.float64] | None = None
    earlier: se2.Array | None = None

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose."""
        return self.state[POSE]


class Tracker:
    """Follows a recording scan by scan.

    Args:
        settings: of the tracker.
        estimator: settings of the score.
        beam: the sensor's errors.
        revolution_s: duration of a turn [s].
    """

    def __init__(self, settings: TrackerConfig, estimator: EstimatorConfig, beam: Beam, revolution_s: float) -> None:
        self._settings = settings
        self._estimator = estimator
        self._matcher = Matcher(estimator, beam, revolution_s)
        self._revolution_s = revolution_s
        self._map = LocalMap(settings)
        self._state = State(np.zeros(SIZE), np.eye(SIZE))  # of the last scan that was matched
        self._t0 = 0.0  # its start [s]
        self._turn_s = revolution_s  # and its duration; the radar may be told to turn at another rate
        self._usual_share = 0.0
        self._smooths = False  # whether the prediction rests on a match, and so smooths the next one

    def start(self, scans: Sequence[Scan], begin: se2.Array | None = None, odometry: se2.Array | None = None) -> Tracked:
        """Find the motion of the first scans from psi alone and begin the map with the first of them.

        Args:
            scans: two or three scans.
            begin: (3,) twist near the truth, or None for an exhaustive search.
            odometry: (3,) what odometry says, for directions in which psi alone does not observe the motion.

        Raises:
            FewReturnsError: a scan holds too few returns.
        """
        if not all(is_usable(scan) for scan in scans):
            counts = ", ".join(str(len(scan.returns)) for scan in scans)
            raise FewReturnsError(f"the first scans hold {counts} returns, and {FEWEST} in each are needed")
        first = self._find_first_motion(scans, begin, odometry)
        return self._begin(scans[0], initial_state(first.motion, first.covariance, self._settings), Status.CONVERGED)

    def first_twist(self, scans: Sequence[Scan]) -> se2.Array:
        """The twist (3,) of two or three scans, without any start."""
        return self._find_first_motion(scans).motion[:3]

    def look_back(self, scan: Scan) -> Tracked:
        """Place a scan of too few returns from before the start."""
        return self._pass_over(scan, predict(self._state, scan.t0 - self._t0, self._settings))

    def loses(self, scan: Scan) -> bool:
        """Whether so much time has passed since the last match that a prediction may miss the scan's place."""
        dt = scan.t0 - self._t0
        if dt <= longest_step(self._turn_s):
            return False
        spread = np.linalg.eigvalsh(self._predict(dt).covariance[:2, :2])[-1]
        return bool(spread > (PIXEL * self._estimator.s_start) ** 2)

    def follow(self, scan: Scan, twist: se2.Array | None = None) -> Tracked:
        """Match the next scan to the map.

        Args:
            scan: the scan.
            twist: (3,) mean twist since the last matched scan according to odometry; it serves where psi alone does not
                find or does not observe the motion.
        """
        predicted = self._predict(scan.t0 - self._t0)
        begin = self._begin_from(predicted, scan, twist)
        if not is_usable(scan):
            return self._pass_over(scan, begin)
        prior = predicted.prior
        found = self._matcher.minimise(scan, predicted.mean, prior, self._map)
        if self._is_out_of_place(found):
            found = self._matcher.search(scan, begin, self._map, [found]).minimum
        if self._is_out_of_place(found):
            return self._miss(scan, begin, found)
        weak = self._weak_directions(scan, found)
        if len(weak):
            held = hold_directions(replace(prior, mean=begin.mean), weak)
            found = self._matcher.minimise(scan, begin.mean, held, self._map)
        return self._accept(scan, found, predicted, weak)

    def resume(self, scans: Sequence[Scan], twist: se2.Array | None = None) -> Tracked:
        """Match the first of the scans behind a gap or a loss, whose motion is found from themselves.

        The scans behind tell how fast the sensor moved at the end of the gap, those before it at its start; between the
        two it moved as the process noise allows. Only a match that is sure and without a rival in that whole region ties
        the two sides. Without one, the track goes on from the prediction with a map of its own.

        Args:
            scans: one to three scans, without a gap between them.
            twist: (3,) mean twist across the gap according to odometry, or None.
        """
        scan, before = scans[0], self._state.pose
        bridged = self._predict(scan.t0 - self._t0)
        first = self._find_motion_behind(scans, bridged)
        if first is not None and scan.t0 - self._t0 <= LONGEST_COAST_S:
            bridged = know_motion(bridged, first.motion, first.covariance)
        elif first is not None:  # nothing before a pause or a jump of the clock tells where its end is
            bridged = take_motion(bridged, first.motion, first.covariance)
        if twist is not None:
            pose = se2.compose(before, se2.exp(twist, scan.t0 - self._t0))
            bridged = State(np.r_[pose, bridged.mean[MOTION]], bridged.covariance)
        if not is_usable(scan):
            return self._pass_over(scan, bridged)
        direct = self._matcher.minimise(scan, bridged.mean, bridged.prior, self._map)
        match = self._matcher.search(scan, bridged, self._map, [direct])
        if not match.rivalled and not self._is_out_of_place(match.minimum):
            weak = self._weak_directions(scan, match.minimum)
            if not len(weak):
                self._smooths = False
                tracked = self._accept(scan, match.minimum, bridged, weak)
                return replace(tracked, arrival=self._arrival(tracked, before))
        if first is None:
            return self._miss(scan, bridged, match.minimum)
        return replace(self._begin(scan, bridged, Status.LOST), arrival=bridged.covariance[POSE, POSE])

    def remeasure(self, scans: Sequence[Scan], tracked: Sequence[Tracked]) -> list[Tracked]:
        """Measure the first scans of a track again, now that there is a map which does not rest on them alone.

        The first scans were matched to a map of a few scans whose own motion was hardly known. The later half of the
        scans is taken as it is; the earlier half is matched to it backward in time, the latest first, and the map goes on
        with the scans where they were found. A scan that is not found so keeps its first measurement.

        Args:
            scans: those of the track so far.
            tracked: what `start`, `follow` or `resume` said of them.
        """
        half = len(scans) // 2
        around = LocalMap(self._settings)
        for scan, t in zip(scans[half:], tracked[half:], strict=True):
            around.add(t.t0, t.pose, self._matcher.place(scan, t.state))
        results = list(tracked)
        after = State(tracked[half].state, self._posterior(tracked[half].evaluation, np.zeros((SIZE, SIZE))))
        for k in range(half - 1, -1, -1):
            predicted = predict(after, scans[k].t0 - scans[k + 1].t0, self._settings)
            found = self._matcher.minimise(scans[k], predicted.mean, predicted.prior, around)
            if self._is_out_of_place(found) or len(self._weak_directions(scans[k], found, around)):
                results[: k + 1] = _move_with(results[k + 1], tracked[k + 1], tracked[: k + 1])
                break
            placed = self._matcher.place(scans[k], found.state)
            covariance = self._measured(found.evaluation, placed, predicted.covariance, around, PREDICTION_GAIN)[:6, :6]
            results[k] = replace(
                tracked[k], state=found.state, covariance=covariance, evaluation=found.evaluation, earlier=tracked[k].pose
            )
            around.add(tracked[k].t0, found.state[POSE], placed)
            after = State(found.state, self._posterior(found.evaluation, predicted.information))
        self._map = LocalMap(self._settings)
        for scan, result in zip(scans, results, strict=True):
            self._map.offer(result.t0, result.pose, self._matcher.place(scan, result.state))
        return results

    def score(self, scan: Scan, pose: se2.Array, twist: se2.Array) -> float:
        """Psi of a scan against the map under another start pose (3,) and constant twist (3,)."""
        return self._matcher.evaluate(scan, np.r_[pose, twist, 0.0, 0.0], final_scale(self._estimator), self._map).psi

    def _find_first_motion(
        self, scans: Sequence[Scan], begin: se2.Array | None = None, odometry: se2.Array | None = None
    ) -> FirstMotion:
        return find_first_motion(
            scans, self._revolution_s, self._estimator, self._matcher.beam, self._settings, begin, odometry
        )

    def _find_motion_behind(self, scans: Sequence[Scan], bridged: State) -> FirstMotion | None:
        """The motion of the scans behind a gap from themselves; None where they do not show it."""
        if len(scans) < 2 or not all(is_usable(scan) for scan in scans):
            return None
        for begin in (bridged.mean[TWIST], None):  # the exhaustive search costs much more
            first = self._find_first_motion(scans, begin)
            if first.observed and not self._is_poor(first.matched):
                return first
        return None

    def _begin(self, scan: Scan, state: State, status: Status) -> Tracked:
        """Begin a new map with a scan."""
        known = state.covariance.copy()
        known[POSE, :] = known[:, POSE] = 0.0
        known[POSE, POSE] = np.diag([1e-8, 1e-8, 1e-12])  # the new map is where this scan is
        self._move_to(scan, State(state.mean, known))
        self._smooths = False
        self._map = LocalMap(self._settings)
        self._map.offer(scan.t0, state.pose, self._matcher.place(scan, state.mean))
        nothing = Evaluation(
            np.zeros(0), np.zeros(0, dtype=bool), np.zeros((0, SIZE)), np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
        )
        return Tracked(scan.t0, state.mean, known[:6, :6], nothing, status, begins_map=True)

    def _arrival(self, tracked: Tracked, before: se2.Array) -> NDArray[np.float64]:
        """Covariance (3, 3) of a match across a gap besides psi's: the sensor's scale enters with the distance."""
        distance = float(np.hypot(*(tracked.pose - before)[:2]))
        return np.diag([(self._settings.sigma_scale * distance) ** 2] * 2 + [0.0])

    def _accept(self, scan: Scan, found: Minimum, predicted: State, weak: NDArray[np.float64]) -> Tracked:
        """Take a match as the new state, and as a keyframe where the last one is far behind."""
        self._move_to(scan, State(found.state, self._posterior(found.evaluation, predicted.information)))
        placed = self._matcher.place(scan, found.state)
        gain = PREDICTION_GAIN if self._smooths else 1.0
        measured = self._measured(found.evaluation, placed, predicted.covariance, self._map, gain)
        self._smooths = True
        measured[POSE, POSE] = loosen(measured[POSE, POSE], weak, spans(self._settings, self._revolution_s))
        memory = _USUAL_MEMORY if self._usual_share > 0.0 else 0.0
        self._usual_share = memory * self._usual_share + (1.0 - memory) * matched_share(found)
        self._map.offer(scan.t0, found.state[POSE], placed)
        status = Status.DEGENERATE if len(weak) else Status.CONVERGED
        return Tracked(scan.t0, found.state, measured[:6, :6], found.evaluation, status)

    def _pass_over(self, scan: Scan, predicted: State) -> Tracked:
        """Follow the prediction for a scan of too few returns."""
        unmatched = self._matcher.evaluate(scan, predicted.mean, final_scale(self._estimator), self._map)
        return self._miss(scan, predicted, Minimum(predicted.mean, unmatched, converged=False))

    def _miss(self, scan: Scan, predicted: State, found: Minimum) -> Tracked:
        """Follow the prediction, at constant twist, for a scan that the map does not show."""
        mean = np.r_[predicted.mean[:6], 0.0, 0.0]
        return Tracked(scan.t0, mean, predicted.covariance[:6, :6], found.evaluation, Status.LOST)

    def _move_to(self, scan: Scan, state: State) -> None:
        self._t0, self._state, self._turn_s = scan.t0, state, scan.t1 - scan.t0

    def _predict(self, dt: float) -> State:
        """The state a time dt [s] after the last match."""
        if dt <= longest_step(self._turn_s):
            return predict(self._state, dt, self._settings)
        state = self._state
        if dt > LONGEST_COAST_S:
            state = State(np.r_[state.pose, np.zeros(SIZE - 3)], state.covariance)
        return coast(state, min(dt, LONGEST_COAST_S), self._turn_s, self._settings)

    def _begin_from(self, predicted: State, scan: Scan, twist: se2.Array | None) -> State:
        """The prediction, or what odometry says in its place."""
        if twist is None:
            return predicted
        pose = se2.compose(self._state.pose, se2.exp(twist, scan.t0 - self._t0))
        return State(np.r_[pose, twist, 0.0, 0.0], predicted.covariance)

    def _is_out_of_place(self, found: Minimum) -> bool:
        """Whether a match is so much poorer than usual that it is probably none."""
        return not overlaps(found) or self._is_poor(matched_share(found))

    def _is_poor(self, share: float) -> bool:
        return share < self._settings.lost_share * self._usual_share

    def _weak_directions(self, scan: Scan, found: Minimum, into: LocalMap | None = None) -> NDArray[np.float64]:
        """Directions (K, 3) of the start pose that the map does not show around a match."""
        wide = self._matcher.evaluate(scan, found.state, annealed_scale(self._estimator, 0), into or self._map)
        return find_weak_directions(wide, 3, self._estimator.observed_share)

    def _measured(
        self, found: Evaluation, placed: PointSet, predicted: NDArray[np.float64], into: LocalMap, gain: float
    ) -> NDArray[np.float64]:
        """Covariance (8, 8) of the state by psi's curvature; what psi does not observe is as sure as the prediction.

        Args:
            found, placed: the match and its points.
            predicted: (8, 8) covariance of the prediction.
            into: the map.
            gain: variance left of psi's own once the prediction has smoothed it.
        """
        known = np.zeros((SIZE, SIZE))  # a vehicle hardly slides: without this, vy would seem as free as vx
        known[4, 4] = self._estimator.correlation / self._settings.sigma_vy**2
        known[6, 6] = self._estimator.correlation / self._settings.sigma_ax**2
        known[7, 7] = self._estimator.correlation / self._settings.sigma_alpha**2
        thin = 1.0 + 1.0 / max(len(into), 1)  # the map's points err as the scan's do, and its keyframes average
        measured = estimate_covariance(found, placed.points, self._estimator.cluster_m, known)
        return fuse(gain * thin * measured, predicted, TOLERANCES)

    def _posterior(self, found: Evaluation, prior_information: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance (8, 8) of the state as the next prediction starts from it."""
        config = self._estimator
        information = (found.curvature + config.stabiliser * found.information) / config.correlation
        units = TOLERANCES[:, None] * TOLERANCES[None, :]
        values, vectors = np.linalg.eigh(information * units)
        safe = (vectors * np.maximum(values, 0.0)) @ vectors.T / units
        return invert_information(safe + prior_information, TOLERANCES)


def is_usable(scan: Scan) -> bool:
    """Whether a scan holds enough returns, in more than one direction, to be matched."""
    if len(scan.returns) < FEWEST:
        return False
    x, y = np.cos(scan.returns.azimuths), np.sin(scan.returns.azimuths)
    around = np.arctan2(y * x.mean() - x * y.mean(), x * x.mean() + y * y.mean())  # about their mean direction
    return bool(np.ptp(around) > _LEAST_SPREAD)


def _move_with(result: Tracked, before: Tracked, others: Sequence[Tracked]) -> list[Tracked]:
    """The others where they lie if they keep their places about a scan that was moved."""
    moved = []
    for other in others:
        pose = se2.compose(result.pose, se2.between(before.pose, other.pose))
        moved.append(replace(other, state=np.r_[pose, other.state[3:]], earlier=other.pose))
    return moved
