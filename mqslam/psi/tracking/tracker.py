"""Odometry by psi over a running map: each scan is matched to the last keyframes.

The state of a scan (see `mqslam.psi.tracking.state`) is found by minimising psi plus what is predicted from the scan before.
The start pose must be free: were it fixed where the last scan ended, errors of successive scans would alternate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.scans import Scan
from mqslam.errors import FewReturnsError
from mqslam.psi.correlate import compute_pixel_m
from mqslam.psi.minimiser import Minimum
from mqslam.psi.observability import spread_along
from mqslam.psi.place import Beam
from mqslam.psi.tracking.cold_start import find_first_motion
from mqslam.psi.tracking.dynamics import (
    Blindness,
    LastMatch,
    hold_directions,
    list_motion_noise,
    predict,
    replace_motion,
)
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.plausibility import FEWEST_RETURNS, Usual, is_usable, measure_overlap, overlaps
from mqslam.psi.tracking.prediction_error import PredictionErrors
from mqslam.psi.tracking.relocalisation import (
    bridge_gap,
    estimate_arrival,
    find_again,
    find_motion_after,
    place_by_odometry,
)
from mqslam.psi.tracking.remeasuring import map_tracked, remeasure
from mqslam.psi.tracking.setup import USUAL, Setup, Tuning
from mqslam.psi.tracking.state import ORIGIN, POSE, TWIST, Belief, State
from mqslam.psi.tracking.tracked import Tracked, make_empty_evaluation
from mqslam.psi.tracking.uncertainty import measure_covariance, update_belief

# Number of matched scans whose smoothed motion is followed along directions that psi does not observe: their mean where it
# is steady, the last one where it changes.
_HELD_SCANS = 32


class Tracker:
    """Follows a recording scan by scan.

    Args:
        settings: of the tracker.
        estimator: settings of the score.
        beam: the sensor's errors.
        revolution_s: duration of a turn [s].
        keyframes: starts [s] of the scans that join the map; None takes those that are far from the one before.
        tuning: how scans are matched to the map.
        is_reversed: whether the recording is played backward, so that speeds have the opposite sign.
    """

    def __init__(
        self,
        settings: TrackerConfig,
        estimator: EstimatorConfig,
        beam: Beam,
        revolution_s: float,
        keyframes: Collection[float] | None = None,
        tuning: Tuning = USUAL,
        *,
        is_reversed: bool = False,
    ) -> None:
        self._chosen = keyframes
        self._setup = Setup(settings, estimator, beam, revolution_s, tuning, is_reversed)
        self._matcher = Matcher(self._setup)
        self._map = LocalMap(tuning, keyframes)
        self._last = LastMatch(0.0, revolution_s, ORIGIN, blind=Blindness.full(settings))
        self._usual = Usual()
        self._prediction_errors = PredictionErrors(tuning, self._setup.matching)

    @property
    def settings(self) -> TrackerConfig:
        """The tracker's settings."""
        return self._setup.settings

    @property
    def keyframes(self) -> list[float]:
        """Starts of the scans that its map holds [s], in order."""
        return self._map.times

    def start(self, scans: Sequence[Scan], begin: se2.Array | None = None, odometry: se2.Array | None = None) -> Tracked:
        """Finds the motion of the first scans from psi alone and begins the map with the first of them.

        Args:
            scans: the first two or more, `START_SCANS` if there are as many.
            begin: (3,) twist near the truth, or None for an exhaustive search.
            odometry: (3,) odometry's twist, for directions in which psi alone does not observe the motion.

        Raises:
            FewReturnsError: a scan holds too few returns.
        """
        if not all(is_usable(scan) for scan in scans):
            counts = ", ".join(str(len(scan.returns)) for scan in scans)
            raise FewReturnsError(f"the first scans hold {counts} returns, and {FEWEST_RETURNS} in each are needed")
        first = find_first_motion(scans, self._setup, begin, odometry)
        changed = np.diag(list_motion_noise(self._setup.young) ** 2)  # the motion may have changed since
        if first.observed:
            self._last = replace(self._last, blind=Blindness.none())
        return self._begin_map(scans[0], replace_motion(ORIGIN, first.motion, changed + first.covariance), Status.CONVERGED)

    def find_first_twist(self, scans: Sequence[Scan]) -> se2.Array:
        """Finds the twist (3,) of a few scans by an exhaustive search."""
        return find_first_motion(scans, self._setup).twist

    def look_back(self, scan: Scan) -> Tracked:
        """Places a scan of too few returns from before the start."""
        return self._pass_over(scan, predict(self._last.belief, scan.t0 - self._last.t0, self.settings))

    def loses(self, scan: Scan) -> bool:
        """Returns whether so much time has passed since the last match that a prediction may miss the scan's place."""
        if self._last.is_before(scan):
            return False
        spread = np.linalg.eigvalsh(self._last.predict(scan, self.settings).covariance[:2, :2])[-1]
        return bool(spread > compute_pixel_m(self._setup.estimator) ** 2)

    def follow(self, scan: Scan, twist: se2.Array | None = None) -> Tracked:
        """Matches the next scan to the map.

        Args:
            scan: the scan.
            twist: (3,) mean twist since the last matched scan according to other sensors, NaN where they do not tell it; it
                serves where psi alone does not find or does not observe the motion.
        """
        predicted = self._last.predict(scan, self._setup.young if self._prediction_errors.is_young else self.settings)
        begin = self._begin_from(predicted, scan, twist)
        if not is_usable(scan):
            return self._pass_over(scan, begin)
        prior = predicted.prior
        minimum = self._matcher.minimise(scan, predicted.mean, prior, self._map, self._prediction_errors.choose_step())
        if self._usual.is_doubtful(minimum, self._setup.tuning.doubtful_psi):
            minimum = self._matcher.look_beside(scan, minimum, prior.information, self._map) or minimum
        if self._is_out_of_place(minimum):
            minimum = self._matcher.search(scan, begin, self._map, [minimum]).minimum
        if self._is_out_of_place(minimum):
            return self._miss(scan, begin, minimum)
        weak, blind = self._matcher.find_weak_directions(scan, State(minimum.state), self._map), Blindness.none()
        if len(weak):
            # a motion that odometry gave is no measurement of psi: odometry itself says how well it is known
            told = np.isfinite([np.nan, np.nan] if twist is None else twist[[0, 2]])
            blind = self._last.blind.forget(told, self.settings).after(scan.t0 - self._last.t0, self.settings)
            steady = self._last.predict_steadily(scan, self.settings) or predicted.mean
            held = self._move_as_told(steady, scan, twist)
            stiff = hold_directions(replace(prior, mean=held.vector), weak)
            minimum = self._matcher.minimise(scan, held, stiff, self._map)
        return self._accept(scan, minimum, predicted, weak, blind)

    def resume(self, scans: Sequence[Scan], twist: se2.Array | None = None) -> Tracked:
        """Matches the first of the scans after a gap or a loss, whose motion is found from themselves.

        Without a sure match the track goes on from the prediction, with a map of its own.

        Args:
            scans: one or more, without a gap between them.
            twist: (3,) mean twist across the gap according to odometry, or None.
        """
        scan, before, dt = scans[0], self._last.pose, scans[0].t0 - self._last.t0
        predicted = self._last.predict(scan, self.settings)
        after = find_motion_after(scans, predicted, self._setup, self._is_poor)
        bridged = place_by_odometry(bridge_gap(predicted, dt, after), before, twist, dt)
        if not is_usable(scan):
            return self._pass_over(scan, bridged)
        minimum, is_sure = find_again(scan, bridged, self._map, self._matcher, self._is_out_of_place)
        if is_sure:
            self._prediction_errors.forget()
            tracked = self._accept(scan, minimum, bridged, np.zeros((0, 3)), Blindness.none())
            return replace(tracked, arrival=estimate_arrival(before, tracked.pose))
        if after is None:
            return self._miss(scan, bridged, minimum)
        return replace(self._begin_map(scan, bridged, Status.LOST), arrival=bridged.covariance[POSE, POSE])

    def remeasure(self, scans: Sequence[Scan], tracked: Sequence[Tracked]) -> list[Tracked]:
        """Measures the first scans of a track again; the map goes on with the scans where they are then.

        Args:
            scans: those of the track so far.
            tracked: what `start`, `follow` or `resume` returned for them.
        """
        results = remeasure(scans, tracked, self._matcher, self._is_out_of_place)
        self._map = map_tracked(scans, results, self._matcher)
        return results

    def score(self, scan: Scan, pose: se2.Array, twist: se2.Array) -> float:
        """Returns psi of a scan against the map under another start pose (3,) and constant twist (3,)."""
        return self._matcher.evaluate(scan, State.at_constant_twist(pose, twist), self._map).psi

    def _begin_from(self, predicted: Belief, scan: Scan, twist: se2.Array | None) -> Belief:
        """Returns the prediction, or the state that other sensors give in its place."""
        return Belief(self._move_as_told(predicted.mean, scan, twist), predicted.covariance)

    def _move_as_told(self, state: State, scan: Scan, twist: se2.Array | None) -> State:
        """Returns the state of a scan with as much of its motion since the last match as a twist (3,) tells."""
        if twist is None:
            return state
        dt = scan.t0 - self._last.t0
        mean = np.where(np.isfinite(twist), twist, se2.log(se2.wrapped_between(self._last.pose, state.pose)) / dt)
        return State.at_constant_twist(se2.compose(self._last.pose, se2.exp(mean, dt)), mean)

    def _begin_map(self, scan: Scan, belief: Belief, status: Status) -> Tracked:
        """Begins a new map with a scan, whose place defines where the map is."""
        known = belief.in_its_own_frame()
        self._last = LastMatch(scan.t0, scan.t1 - scan.t0, known, blind=self._last.blind)
        self._prediction_errors.forget()
        self._map = LocalMap(self._setup.tuning, self._chosen)
        self._map.offer(scan.t0, known.pose, self._matcher.place(scan, known.mean))
        middle_s = 0.5 * (scan.t1 - scan.t0)  # an error of its twist turns the scan about its start, and so the map
        covariance, skew = known.covariance[POSE, POSE], known.covariance[TWIST, TWIST] * middle_s**2
        return Tracked(scan.t0, known.mean, covariance, skew, make_empty_evaluation(), status, begins_map=True)

    def _accept(
        self, scan: Scan, minimum: Minimum, predicted: Belief, weak: NDArray[np.float64], blind: Blindness
    ) -> Tracked:
        """Takes a match as the new state, and as a keyframe where the last one is far away."""
        setup, evaluation = self._setup, minimum.evaluation
        belief = update_belief(minimum.state, evaluation, predicted.information, setup, weak)
        placed = self._matcher.place(scan, belief.mean)
        covariance = measure_covariance(evaluation, placed, predicted, self._map, setup)[POSE, POSE]
        self._usual = self._usual.after(minimum)
        observed = () if len(weak) else (belief.mean.twist,)
        twists = (*self._last.twists, *observed)[-_HELD_SCANS:]
        self._last = LastMatch(scan.t0, scan.t1 - scan.t0, belief, blind=blind, twists=twists)
        self._prediction_errors.add(self._matcher.place(scan, predicted.mean), placed)
        self._map.offer(scan.t0, belief.pose, placed)
        status = Status.DEGENERATE if len(weak) else Status.CONVERGED
        return Tracked(scan.t0, belief.mean, covariance, spread_along(weak, blind.pose), evaluation, status)

    def _pass_over(self, scan: Scan, predicted: Belief) -> Tracked:
        """Follows the prediction for a scan of too few returns."""
        unmatched = self._matcher.evaluate(scan, predicted.mean, self._map)
        return self._miss(scan, predicted, Minimum(predicted.mean.vector, unmatched, converged=False))

    def _miss(self, scan: Scan, predicted: Belief, minimum: Minimum) -> Tracked:
        """Follows the prediction, at constant twist, for a scan that the map does not show."""
        state = State.at_constant_twist(predicted.pose, predicted.mean.twist)
        return Tracked(scan.t0, state, np.zeros((3, 3)), predicted.covariance[POSE, POSE], minimum.evaluation, Status.LOST)

    def _is_out_of_place(self, minimum: Minimum) -> bool:
        """Returns whether a match is so much poorer than usual that it is probably none."""
        return not overlaps(minimum) or self._is_poor(measure_overlap(minimum))

    def _is_poor(self, share: float) -> bool:
        """Returns whether a matched share is much poorer than the usual one."""
        return self._usual.is_poor(share)
