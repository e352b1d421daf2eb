"""Matches one scan after the other to a running map of the last keyframes.

The state of a scan (see `mqslam.psi.tracking.state`) is found by minimising psi plus a prior, which is the prediction from
the scan before. The start pose must be free: if it were fixed at the end of the last scan, the errors of successive scans
would alternate in sign. A scan without a plausible match is lost.

After a gap or lost scans, the scans before the gap show the motion at its start, and the scans after the gap show the motion
at its end. During the gap, the sensor moved as the process noise allows. The scan after the gap is matched to the old map
only if the match is sure and has no rival in the whole region that the sensor may have reached.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.scans import Scan
from mqslam.errors import FewReturnsError
from mqslam.psi.correlate import compute_pixel_m
from mqslam.psi.covariance import spread_along
from mqslam.psi.minimiser import Minimum
from mqslam.psi.place import Beam
from mqslam.psi.score import PsiEvaluation
from mqslam.psi.tracking.cold_start import FirstMotion, find_first_motion
from mqslam.psi.tracking.local_map import USUAL, LocalMap, Tuning
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.plausibility import FEWEST_RETURNS, PredictionErrors, Usual, is_usable, overlaps
from mqslam.psi.tracking.state import (
    CONTRADICTED,
    LONGEST_COAST_S,
    ORIGIN,
    POSE,
    SIZE,
    TWIST,
    UNSHOWN,
    Belief,
    Blindness,
    LastMatch,
    State,
    correct_motion,
    guide,
    hold_directions,
    list_motion_noise,
    predict,
    replace_motion,
)

# Number of matched scans whose smoothed twist is kept along directions that psi does not observe.
_HELD_SCANS = 32
# Standard deviation of the distance across a gap, as a share of the distance. Published lengths of one radar's range bins
# differ by 1.4 %, and a Doppler shift that is ignored causes as large an error.
_SIGMA_SCALE = 0.01

_ALL_OBSERVED = np.zeros((0, 3))  # no weak direction
_NOTHING = PsiEvaluation(
    np.zeros(0), np.zeros(0, dtype=bool), np.zeros((0, SIZE)), np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
)  # psi of a scan for which there was no map


@dataclass(frozen=True, slots=True)
class Tracked:
    """The result of tracking one scan. All poses and covariances are in x, y [m], yaw [rad], in the tracker's frame.

    Args:
        t0: start of the scan [s since the recording's start].
        state: start pose and motion of the scan.
        covariance: (3, 3) covariance of the start pose relative to the map, by psi and the prediction together; zero
            without a match, and zero but for rounding if a map begins with the scan.
        unseen: (3, 3) covariance to add to `covariance` where psi does not observe a direction, where there is no match, or
            where a map begins with a scan whose twist is uncertain.
        evaluation: psi of the scan in `state`, or at the rejected match of a lost scan; empty if a new map begins with it.
        status: how far the state can be trusted; `LOST` also for a scan that begins a map after a gap or lost scans.
        begins_map: whether a new map begins with this scan.
        arrival: (3, 3) covariance that a gap or lost scans before the scan add to its start pose; None if there are none.
        earlier: (3,) start pose by the first measurement if the scan was measured a second time, else None.
        psi_odometry: psi at the pose that odometry predicts; NaN without odometry.
    """

    t0: float
    state: State
    covariance: NDArray[np.float64]
    unseen: NDArray[np.float64]
    evaluation: PsiEvaluation
    status: Status
    begins_map: bool = False
    arrival: NDArray[np.float64] | None = None
    earlier: se2.Array | None = None
    psi_odometry: float = float("nan")

    @property
    def pose(self) -> se2.Array:
        """(3,) x, y [m], yaw [rad] of the sensor at the start of the scan, in the tracker's frame."""
        return self.state.pose

    @property
    def is_found(self) -> bool:
        """Whether the track goes on from this scan, because it was matched or because a new map begins with it."""
        return self.status is not Status.LOST or self.begins_map


class Tracker:
    """Matches one scan after the other to a map of the last keyframes.

    The tracker's frame is the sensor's frame at the start of the first scan that `start` takes.

    Args:
        settings: settings of the tracker.
        estimator: settings of the score.
        beam: the sensor's errors.
        revolution_s: duration of a revolution of the radar [s].
        keyframes: starts [s] of the scans that join the map; None takes scans that are far from the others.
        tuning: settings for matching scans to the map.
        is_reversed: whether the recording is played backward, so that speeds have the opposite sign.
        is_guided: whether a scan is predicted by odometry, where there is any, in place of the motion so far; also an
            attribute.
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
        is_guided: bool = False,
    ) -> None:
        self.is_guided = is_guided
        self._settings, self._tuning, self._chosen = settings, tuning, keyframes
        self._matcher = Matcher(settings, estimator, beam, revolution_s, tuning, is_reversed)
        self._map = LocalMap(tuning, keyframes)
        self._last = LastMatch(0.0, revolution_s, ORIGIN, blind=Blindness.full(settings))
        self._usual = Usual()
        self._prediction_errors = PredictionErrors(tuning, self._matcher.matching)

    @property
    def keyframes(self) -> list[float]:
        """Starts [s] of the scans that the tracker's map holds, in order."""
        return self._map.times

    def start(self, scans: Sequence[Scan], begin: se2.Array | None = None, odometry: se2.Array | None = None) -> Tracked:
        """Finds the motion of the first scans, begins the map with the first scan, and returns this scan's result.

        Args:
            scans: the first `START_SCANS` scans, or fewer if the recording has fewer, but at least two.
            begin: (3,) vx, vy [m/s], omega [rad/s] at which the minimiser starts; None searches exhaustively.
            odometry: (3,) vx, vy, omega by odometry, or None. A guided tracker takes it as the motion, and ignores `begin`.
                A tracker that is not guided starts the minimiser from it, too, if psi does not observe every direction.

        Raises:
            FewReturnsError: a scan holds too few returns.
        """
        if not all(is_usable(scan) for scan in scans):
            counts = ", ".join(str(len(scan.returns)) for scan in scans)
            raise FewReturnsError(
                f"the first scans hold {counts} returns; each needs {FEWEST_RETURNS} in more than one direction"
            )
        first = self._follow_odometry(odometry) or find_first_motion(scans, self._matcher, begin, odometry)
        changed = np.diag(list_motion_noise(self._matcher.young) ** 2)  # the motion may change while these scans last
        if first.observed:
            self._last = replace(self._last, blind=Blindness.none())
        return self._begin_map(scans[0], replace_motion(ORIGIN, first.motion, changed + first.covariance), Status.CONVERGED)

    def look_back(self, scan: Scan, twist: se2.Array | None = None) -> Tracked:
        """Predicts the pose of a scan that lies before the start of the track; the scan counts as lost.

        Args:
            scan: the scan.
            twist: (3,) mean twist [m/s, m/s, rad/s] by odometry from the scan to the start of the track, or None.
        """
        if self.is_guided and twist is not None:
            return self._pass_over(scan, guide(self._last.belief, twist, scan.t0 - self._last.t0))
        return self._pass_over(scan, predict(self._last.belief, scan.t0 - self._last.t0, self._settings))

    def loses(self, scan: Scan) -> bool:
        """Returns whether a scan follows a gap after which a prediction is less exact than a pixel of the global search.

        The result is False if the tracker is guided, because odometry bridges the gap.
        """
        if self.is_guided or self._last.is_before(scan):
            return False
        spread = np.linalg.eigvalsh(self._last.predict(scan, self._settings).covariance[:2, :2])[-1]
        return bool(spread > compute_pixel_m(self._matcher.estimator) ** 2)

    def follow(self, scan: Scan, twist: se2.Array | None = None) -> Tracked:
        """Matches the next scan to the map; without a plausible match, the result is the prediction, with status `LOST`.

        Args:
            scan: the scan.
            twist: (3,) mean twist [m/s, m/s, rad/s] by odometry since the last matched scan, NaN for components that are not
                measured, or None. It is used where psi alone does not find or observe the motion, and for the prediction if
                the tracker is guided.
        """
        matcher, last = self._matcher, self._last
        predicted = last.predict(scan, matcher.young if self._prediction_errors.is_young else self._settings)
        if self.is_guided and twist is not None and np.isfinite(twist).all():
            predicted = guide(last.belief, twist, scan.t0 - last.t0)
        begin = Belief(self._move_by(twist, predicted.mean, scan), predicted.covariance)
        if not is_usable(scan):
            return self._pass_over(scan, begin)
        prior = predicted.prior
        minimum = matcher.minimise(scan, predicted.mean, prior, self._map, self._prediction_errors.choose_step())
        if self._is_doubtful(minimum):
            if self.is_guided:  # where wheels slip, odometry may be wrong by any motion
                minimum, _ = matcher.search(scan, begin, self._map, minimum, self._is_doubtful)
            else:
                minimum = matcher.look_beside(scan, minimum, prior.information, self._map) or minimum
        if self._is_out_of_place(minimum):
            minimum, _ = matcher.search(scan, begin, self._map, minimum)
        if self.is_guided and self._is_out_of_place(minimum):
            minimum = self._look_around(scan, minimum)
        if self._is_out_of_place(minimum):
            return self._miss(scan, begin, minimum.evaluation)
        weak, blind = matcher.find_weak_directions(scan, State(minimum.state), self._map), Blindness.none()
        if len(weak):
            # psi did not measure the components of the motion that odometry gave: odometry itself states their uncertainty
            known = np.isfinite([np.nan, np.nan] if twist is None else twist[[0, 2]])
            blind = last.blind.forget(known, self._settings).after(scan.t0 - last.t0, self._settings)
            start = self._move_by(twist, last.predict_steadily(scan, self._settings) or predicted.mean, scan)
            held = matcher.minimise(scan, start, hold_directions(replace(prior, mean=start.vector), weak), self._map)
            # wheels that slip, or stamps that are wrong, would hold a scan where it does not fit
            minimum = minimum if self.is_guided and self._is_out_of_place(held) else held
        return self._accept(scan, minimum, predicted, weak, blind)

    def resume(self, scans: Sequence[Scan], twist: se2.Array | None = None) -> Tracked:
        """Matches the first scan after a gap or after lost scans, with the motion that this scan and the next ones show.

        A match is sure if psi observes every direction, enough returns match, and no other place fits about as well. Without
        a sure match, a new map begins at the predicted pose, or the scan is lost if the scans show no motion. A scan with
        too few returns is lost, too.

        Args:
            scans: one or more scans after the gap or the lost scans, without a gap between them.
            twist: (3,) mean twist [m/s, m/s, rad/s] across the gap by odometry, without NaN, or None.
        """
        scan, before, dt = scans[0], self._last.pose, scans[0].t0 - self._last.t0
        if self.is_guided and twist is not None:
            bridged, after = guide(self._last.belief, twist, dt), self._follow_odometry(twist)
        else:
            bridged = self._last.predict(scan, self._settings)
            after = self._find_motion_after(scans, bridged)
        if after is not None:
            # the motion before a pause or a jump of the clock does not predict the motion after it
            join = correct_motion if dt <= LONGEST_COAST_S else replace_motion
            bridged = join(bridged, after.motion, after.covariance)
        if twist is not None:
            pose = se2.compose(before, se2.exp(twist, dt))
            bridged = Belief(State.of(pose, bridged.mean.motion), bridged.covariance)
        if not is_usable(scan):
            return self._pass_over(scan, bridged)
        direct = self._matcher.minimise(scan, bridged.mean, bridged.prior, self._map)
        minimum, is_rivalled = self._matcher.search(scan, bridged, self._map, direct)
        if not is_rivalled and not self._is_out_of_place(minimum) and self._observes_all(scan, minimum, self._map):
            self._prediction_errors.forget()
            tracked = self._accept(scan, minimum, bridged, _ALL_OBSERVED, Blindness.none())
            distance = float(np.hypot(*(tracked.pose - before)[:2]))
            return replace(tracked, arrival=np.diag([(_SIGMA_SCALE * distance) ** 2] * 2 + [0.0]))
        if after is None:
            return self._miss(scan, bridged, minimum.evaluation)
        return replace(self._begin_map(scan, bridged, Status.LOST), arrival=bridged.covariance[POSE, POSE])

    def remeasure(self, scans: Sequence[Scan], tracked: Sequence[Tracked]) -> list[Tracked]:
        """Measures the first scans of a map again, and makes the map anew from the scans at their new poses.

        The first scans were matched to a map of a few scans whose own motion was hardly known. The later half of the
        scans keeps its poses; the earlier half is matched to the later half backward in time, the latest scan first. This
        ends at a scan that does not match, or where psi does not observe every direction. All motions up to this scan, and
        its motion to the next scan, then stay as they were first measured. A guided tracker changes nothing.

        Args:
            scans: scans of the map so far.
            tracked: the results of `start`, `follow` or `resume` for these scans.

        Returns:
            The new results of these scans.
        """
        matcher, half, results = self._matcher, len(scans) // 2, list(tracked)
        if self.is_guided:  # odometry predicted these scans as well as all others
            return results
        around = LocalMap(self._tuning)
        for scan, t in zip(scans[half:], tracked[half:], strict=True):
            around.add(t.t0, t.pose, matcher.place(scan, t.state))
        latest = tracked[half]
        after = matcher.update_belief(Minimum(latest.state.vector, latest.evaluation, True), np.zeros((SIZE, SIZE)))
        for k in range(half - 1, -1, -1):
            predicted = predict(after, scans[k].t0 - scans[k + 1].t0, self._settings)
            minimum = matcher.minimise(scans[k], predicted.mean, predicted.prior, around)
            if self._is_out_of_place(minimum) or not self._observes_all(scans[k], minimum, around):
                for n, t in enumerate(tracked[: k + 1]):
                    pose = se2.compose(results[k + 1].pose, se2.between(tracked[k + 1].pose, t.pose))
                    results[n] = replace(t, state=State.of(pose, t.state.motion), earlier=t.pose)
                break
            state = State(minimum.state)
            placed = matcher.place(scans[k], state)
            results[k] = replace(
                tracked[k],
                state=state,
                covariance=matcher.measure_covariance(minimum.evaluation, placed, predicted, around),
                unseen=np.zeros((3, 3)),
                evaluation=minimum.evaluation,
                earlier=tracked[k].pose,
            )
            around.add(tracked[k].t0, state.pose, placed)
            after = matcher.update_belief(minimum, predicted.information)
        self._map = LocalMap(self._tuning)
        for scan, t in zip(scans, results, strict=True):
            self._map.offer(t.t0, t.pose, matcher.place(scan, t.state))
        return results

    def score(self, scan: Scan, pose: se2.Array, twist: se2.Array) -> float:
        """Returns psi of a scan against the map at a pose (3,) [m, m, rad] and a constant twist (3,) [m/s, m/s, rad/s]."""
        return self._matcher.evaluate(scan, State.at_constant_twist(pose, twist), self._map).psi

    def _move_by(self, twist: se2.Array | None, state: State, scan: Scan) -> State:
        """Returns a scan's state by odometry's mean twist (3,) since the last match, or `state` if the twist is None.

        For a component that is NaN, the mean twist from the last match to `state` is taken.
        """
        if twist is None:
            return state
        dt = scan.t0 - self._last.t0
        mean = np.where(np.isfinite(twist), twist, se2.log(se2.wrapped_between(self._last.pose, state.pose)) / dt)
        return State.at_constant_twist(se2.compose(self._last.pose, se2.exp(mean, dt)), mean)

    def _look_around(self, scan: Scan, minimum: Minimum) -> Minimum:
        """Looks for a match near the last match's pose, in case odometry jumped; returns `minimum` if none is found."""
        still = guide(self._last.belief, np.zeros(3), scan.t0 - self._last.t0)
        here = self._matcher.minimise(scan, still.mean, still.prior, self._map)
        found, _ = self._matcher.search(scan, still, self._map, here)
        return minimum if self._is_out_of_place(found) else found

    def _follow_odometry(self, twist: se2.Array | None) -> FirstMotion | None:
        """Returns odometry's twist (3,) as the motion of the scans; None without a twist or if the tracker is not guided."""
        if not self.is_guided or twist is None:
            return None
        return FirstMotion(np.r_[twist, 0.0, 0.0], np.diag(list_motion_noise(self._settings) ** 2), 1.0, observed=True)

    def _find_motion_after(self, scans: Sequence[Scan], predicted: Belief) -> FirstMotion | None:
        """Finds the motion of the scans after a gap from these scans alone.

        Returns None for a single scan, too few returns, too few matched returns, or a direction that psi does not observe.
        """
        if len(scans) < 2 or not all(is_usable(scan) for scan in scans):
            return None
        for begin in (predicted.mean.twist, None):  # the exhaustive search costs much more
            first = find_first_motion(scans, self._matcher, begin)
            if first.observed and not self._usual.is_poor(first.matched):
                return first
        return None

    def _begin_map(self, scan: Scan, belief: Belief, status: Status) -> Tracked:
        """Begins a new map with a scan; the pose of `belief` counts as exact, since it defines the frame of the map."""
        known = belief.in_its_own_frame()
        self._last = LastMatch(scan.t0, scan.t1 - scan.t0, known, blind=self._last.blind)
        self._prediction_errors.forget()
        self._map = LocalMap(self._tuning, self._chosen)
        self._map.offer(scan.t0, known.pose, self._matcher.place(scan, known.mean))
        middle_s = 0.5 * (scan.t1 - scan.t0)  # an error of the twist moves the scan's midpoint, and the map with it
        covariance, skew = known.covariance[POSE, POSE], known.covariance[TWIST, TWIST] * middle_s**2
        return Tracked(scan.t0, known.mean, covariance, skew, _NOTHING, status, begins_map=True)

    def _accept(
        self, scan: Scan, minimum: Minimum, predicted: Belief, weak: NDArray[np.float64], blind: Blindness
    ) -> Tracked:
        """Makes a match the tracker's last match, offers its scan to the map as a keyframe, and returns the scan's result.

        `weak` (K, 3) are the directions of the start pose that psi does not observe, and `blind` is the uncertainty of the
        motion along them.
        """
        belief = self._matcher.update_belief(minimum, predicted.information, weak)
        placed = self._matcher.place(scan, belief.mean)
        covariance = self._matcher.measure_covariance(minimum.evaluation, placed, predicted, self._map)
        self._usual = self._usual.after(minimum)
        observed = () if len(weak) else (belief.mean.twist,)
        twists = (*self._last.twists, *observed)[-_HELD_SCANS:]
        self._last = LastMatch(scan.t0, scan.t1 - scan.t0, belief, blind=blind, twists=twists)
        self._prediction_errors.add(self._matcher.place(scan, predicted.mean), placed)
        self._map.offer(scan.t0, belief.pose, placed)
        status = Status.DEGENERATE if len(weak) else Status.CONVERGED
        unseen = spread_along(weak, UNSHOWN if self.is_guided else blind.pose)
        return Tracked(scan.t0, belief.mean, covariance, unseen, minimum.evaluation, status)

    def _pass_over(self, scan: Scan, predicted: Belief) -> Tracked:
        """Returns the prediction as the result of a scan with too few returns or before the track; it counts as lost."""
        passed = self._miss(scan, predicted, self._matcher.evaluate(scan, predicted.mean, self._map))
        return replace(passed, unseen=predicted.covariance[POSE, POSE])

    def _miss(self, scan: Scan, predicted: Belief, evaluation: PsiEvaluation) -> Tracked:
        """Returns the prediction, without accelerations, as the result of a lost scan, with the given evaluation of psi."""
        state = State.at_constant_twist(predicted.pose, predicted.mean.twist)
        unseen = predicted.covariance[POSE, POSE] + (CONTRADICTED if self.is_guided else 0.0)
        return Tracked(scan.t0, state, np.zeros((3, 3)), unseen, evaluation, Status.LOST)

    def _is_doubtful(self, minimum: Minimum) -> bool:
        """Returns whether psi at a match is so much higher than usual that a better match is searched for."""
        return self._usual.is_doubtful(minimum, self._tuning.doubtful_psi)

    def _is_out_of_place(self, minimum: Minimum) -> bool:
        """Returns whether a match is probably wrong, since scan and map hardly overlap or overlap much less than usual."""
        return not overlaps(minimum) or self._usual.is_poor(minimum.evaluation.overlap)

    def _observes_all(self, scan: Scan, minimum: Minimum, into: LocalMap) -> bool:
        """Returns whether psi observes every direction at a match."""
        return not len(self._matcher.find_weak_directions(scan, State(minimum.state), into))
