"""Odometry by psi over a running map: each revolution is matched to the last keyframes.

The state of a revolution (see `mqslam.psi.dynamics`) is found by minimising psi plus the state predicted from the
revolution before. The start pose must be free: were it fixed where the last revolution ended, errors of successive
revolutions would alternate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam import se2
from mqslam.config import Config, Scale
from mqslam.errors import EstimationError
from mqslam.measurement import Status
from mqslam.motion import CONSTANT_TWIST, LONGEST_COAST_S
from mqslam.psi.correlate import PIXEL, correlation_peaks
from mqslam.psi.covariance import sandwich
from mqslam.psi.dynamics import MODEL, SIZE, TOLERANCES, held, initial_covariance, predict, spans
from mqslam.psi.estimator import Evaluation
from mqslam.psi.localmap import LocalMap
from mqslam.psi.minimiser import Minimum, Prior, minimise, score
from mqslam.psi.neighbours import candidates
from mqslam.psi.observability import loosened, weak_directions
from mqslam.psi.place import PointSet, place
from mqslam.psi.window import beam_of, estimate_window, search_twist
from mqslam.returns import Returns, Window

START_REVOLUTIONS = 3  # that start the tracker together
PREDICTION_GAIN = 0.1  # variance left of psi's own once the state before has smoothed it; measured, see BENCHMARKS.md
_USUAL_MEMORY = 0.95  # the usual matched share forgets with this factor per revolution
_SEARCH_M, _SEARCH_RAD = 30.0, 0.8  # farthest that a lost track is searched around its prediction
_GROWN = 8  # keyframes of a map from which on they are as far apart as the settings say
_PATIENCE = 8  # lost revolutions in a row before the map is given up and a new one begun
_FEWEST = 20  # returns below which revolutions hold nothing to match


@dataclass(frozen=True, slots=True)
class Tracked:
    """One revolution, matched.

    Args:
        t0: its start [s].
        state: (8,) as in `mqslam.psi.dynamics`.
        covariance: (6, 6) of start pose and twist, given the map, from psi's curvature.
        evaluation: psi at the minimum.
        status: how far it can be trusted.
    """

    t0: float
    state: se2.Array
    covariance: NDArray[np.float64]
    evaluation: Evaluation
    status: Status

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose."""
        return self.state[:3]


class Tracker:
    """Follows a recording revolution by revolution.

    Args:
        config: all settings.
        revolution_s: duration of a turn [s].
    """

    def __init__(self, config: Config, revolution_s: float) -> None:
        self._settings = config.tracker
        self._estimator = config.estimator
        self._revolution_s = revolution_s
        self._beam = beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
        self._map = LocalMap(config.tracker.keyframes)
        self._state = np.zeros(SIZE)
        self._covariance = initial_covariance(config.tracker)
        self._t0 = 0.0
        self._turn_s = revolution_s  # of the last revolution followed; the radar may be told to turn at another rate
        self._keyframe: se2.Array | None = None
        self._usual_share = 0.0
        self._lost: list[Window] = []
        self._patience = _PATIENCE

    def start(
        self, windows: list[Window], begin: se2.Array | None = None, odometry: se2.Array | None = None
    ) -> Tracked:
        """Find the motion of the first revolutions from psi alone and begin the map with the first of them.

        Args:
            windows: two or three revolutions.
            begin: (3,) twist near the truth, or None for an exhaustive search.
            odometry: (3,) what odometry says, for where psi alone does not observe the motion.

        Raises:
            EstimationError: the windows hold too few returns.
        """
        returns = Returns.concatenate([w.returns for w in windows])
        if len(returns) < _FEWEST:
            raise EstimationError(
                f"only {len(returns)} returns in {len(windows)} revolutions; lower detector.threshold"
            )
        theta, _ = self._first_motion(windows, begin, odometry)
        self._t0, self._state = windows[0].t0, np.r_[np.zeros(3), theta]
        self._turn_s = windows[0].t1 - windows[0].t0
        self._add_keyframe(self._place(windows[0], self._state))
        empty = Evaluation(
            np.zeros(0), np.zeros(0, dtype=bool), np.zeros((0, SIZE)), np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
        )
        return Tracked(self._t0, self._state, self._covariance[:6, :6], empty, Status.CONVERGED)

    def first_twist(self, windows: list[Window]) -> se2.Array:
        """The twist (3,) of two or three revolutions, without any start."""
        return self._first_motion(windows)[0][:3]

    def follow(self, window: Window, twist: se2.Array | None = None) -> Tracked:
        """Match the next revolution to the map.

        Args:
            window: one revolution.
            twist: (3,) mean twist since the last revolution according to odometry; it serves where psi alone does not find
                or does not observe the motion.
        """
        dt = window.t0 - self._t0
        if dt > LONGEST_COAST_S:
            self._state = np.r_[self._state[:3], np.zeros(MODEL.size)]
            self._patience = START_REVOLUTIONS  # the map of before is probably of elsewhere
        predicted, covariance = predict(
            self._state, self._covariance, min(dt, LONGEST_COAST_S), 1.5 * self._turn_s, self._settings
        )
        self._turn_s = window.t1 - window.t0
        information = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        begin = predicted
        if twist is not None:
            begin = np.r_[se2.compose(self._state[:3], se2.exp(twist, dt)), twist, 0.0, 0.0]
        found = self._minimise(window, predicted, Prior(predicted, information))
        if self._out_of_place(found):
            found = self._searched(window, Prior(begin, information), found)
        self._t0 = window.t0
        if self._out_of_place(found):
            return self._coast(window, begin, covariance, found)
        self._lost, self._patience = [], _PATIENCE
        weak = weak_directions(self._evaluate(window, found.state, self._estimator.scale(0)), 3)
        if len(weak):
            found = self._minimise(window, begin, held(Prior(begin, information), weak))
        return self._accept(window, found, covariance, information, weak)

    def score(self, window: Window, pose: se2.Array, twist: se2.Array) -> float:
        """psi of a revolution against the map under another start pose (3,) and constant twist (3,)."""
        return self._evaluate(window, np.r_[pose, twist, 0.0, 0.0], self._estimator.final).psi

    def _accept(
        self,
        window: Window,
        found: Minimum,
        predicted: NDArray[np.float64],
        information: NDArray[np.float64],
        weak: NDArray[np.float64],
    ) -> Tracked:
        """Take a match as the new state, and as a keyframe where the last one is far behind."""
        self._state = found.state
        self._covariance = self._posterior(found.evaluation, information)
        placed = self._place(window, found.state)
        measured = self._measured(found.evaluation, placed, predicted)
        measured[:3, :3] = loosened(measured[:3, :3], weak, spans(self._settings, self._revolution_s))
        memory = _USUAL_MEMORY if self._usual_share > 0.0 else 0.0
        self._usual_share = memory * self._usual_share + (1.0 - memory) * _share(found)
        if self._far_from_keyframe():
            self._add_keyframe(placed)
        status = Status.DEGENERATE if len(weak) else Status.CONVERGED
        return Tracked(window.t0, found.state, measured[:6, :6], found.evaluation, status)

    def _coast(
        self, window: Window, predicted: se2.Array, covariance: NDArray[np.float64], found: Minimum
    ) -> Tracked:
        """Follow the prediction at constant twist; after a few revolutions of it begin a new map."""
        self._state, self._covariance = np.r_[predicted[:6], 0.0, 0.0], covariance
        self._lost = [*self._lost, window]
        if len(self._lost) == self._patience:
            self._begin_again(self._lost[-START_REVOLUTIONS:])
            self._lost, self._patience = [], _PATIENCE
        return Tracked(window.t0, predicted, covariance[:6, :6], found.evaluation, Status.LOST)

    def _begin_again(self, windows: list[Window]) -> None:
        """Start a new map with the last of the windows, where they agree on a motion of their own."""
        if sum(len(w.returns) for w in windows) < _FEWEST:
            return
        theta, share = self._first_motion(windows)
        if share < self._settings.lost_share * self._usual_share:
            return
        into = windows[-1].t0 - windows[0].t0
        now, _ = predict(np.r_[np.zeros(3), theta], self._covariance, into, into, self._settings)
        self._state = np.r_[self._state[:3], now[3:]]
        self._covariance = initial_covariance(self._settings)
        self._map = LocalMap(self._settings.keyframes)
        self._add_keyframe(self._place(windows[-1], self._state))

    def _first_motion(
        self, windows: list[Window], begin: se2.Array | None = None, odometry: se2.Array | None = None
    ) -> tuple[se2.Array, float]:
        """Motion parameters (5,) at the start of two or three revolutions from psi alone, and their matched share."""
        t0, config = windows[0].t0, self._estimator
        if begin is None:
            begin = self._cold_start(Returns.concatenate([w.returns for w in windows[:2]]), t0)
        model = MODEL if len(windows) > 2 else CONSTANT_TWIST
        returns = Returns.concatenate([w.returns for w in windows])
        motion = estimate_window(returns, t0, self._revolution_s, config, self._beam, begin, model)
        if odometry is not None and motion.status is not Status.CONVERGED:
            motion = estimate_window(returns, t0, self._revolution_s, config, self._beam, odometry, model)
        theta = np.zeros(MODEL.size)
        theta[: model.size] = motion.theta
        return theta, _share(motion.minimum)

    def _cold_start(self, returns: Returns, t0: float) -> se2.Array:
        """The twist of two revolutions by exhaustive search over speed and yaw rate."""
        settings = self._settings
        reach = self._estimator.s_start / 13.0  # travel per revolution that the annealing surely bridges
        speeds = np.arange(settings.speed_min, settings.speed_max + 1e-9, reach / self._revolution_s)
        limit = min(settings.omega_max, 1.0 / self._revolution_s)
        count = int(np.ceil(limit / (0.025 / self._revolution_s)))
        yaw_rates = np.linspace(-limit, limit, 2 * count + 1)
        strong = returns.take(returns.intensities >= np.median(returns.intensities))
        twist, _ = search_twist(strong, t0, self._revolution_s, self._estimator, self._beam, speeds, yaw_rates)
        return twist

    def _out_of_place(self, found: Minimum) -> bool:
        """Whether a match is so much poorer than usual that it is probably none."""
        share = _share(found)
        return share == 0.0 or share < self._settings.lost_share * self._usual_share

    def _searched(self, window: Window, prior: Prior, found: Minimum) -> Minimum:
        """The best match around the prediction, as far as that may be off."""
        spread = np.sqrt(np.diag(np.linalg.inv(prior.information)))
        reach_m = float(np.clip(2.0 * np.hypot(spread[0], spread[1]), 3.0, _SEARCH_M))
        reach_rad = float(np.clip(2.0 * spread[2], 0.05, _SEARCH_RAD))
        own = self._place(window, np.r_[np.zeros(3), prior.mean[3:]]).points
        best = found
        pixel_m = PIXEL * self._estimator.s_start
        for pose in correlation_peaks(self._map.points.points, own, prior.mean[:3], reach_m, reach_rad, pixel_m):
            begin = np.r_[pose, prior.mean[3:]]
            tried = self._minimise(window, begin, Prior(begin, prior.information))
            if tried.evaluation.psi < best.evaluation.psi:
                best = tried
        return best

    def _evaluate(self, window: Window, state: se2.Array, scale: Scale) -> Evaluation:
        placed = self._place(window, state)
        lists = candidates(self._map.grid, placed.points, scale.s)
        return score(placed, self._map.points, lists, scale, self._revolution_s, self._estimator)

    def _minimise(self, window: Window, start: se2.Array, prior: Prior) -> Minimum:
        return minimise(
            start, lambda state: self._place(window, state), self._map.points, prior, self._estimator,
            self._revolution_s, TOLERANCES, self._map.grid,
        )  # fmt: skip

    def _measured(
        self, found: Evaluation, placed: PointSet, predicted: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Covariance (8, 8) of the state by psi's curvature; what psi does not observe is as sure as the prediction."""
        known = np.zeros((SIZE, SIZE))  # a vehicle hardly slides: without this, vy would seem as free as vx
        known[4, 4] = self._estimator.correlation / self._settings.sigma_vy**2
        known[6, 6] = self._estimator.correlation / self._settings.sigma_ax**2
        known[7, 7] = self._estimator.correlation / self._settings.sigma_alpha**2
        spread = PREDICTION_GAIN * sandwich(found, placed.points, known)
        return np.asarray(np.linalg.inv(np.linalg.inv(spread) + np.linalg.inv(predicted)))

    def _posterior(self, found: Evaluation, prior_information: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance (8, 8) of the state as the next prediction starts from it."""
        config = self._estimator
        information = (found.curvature + config.stabiliser * found.information) / config.correlation
        values, vectors = np.linalg.eigh(information * TOLERANCES[:, None] * TOLERANCES[None, :])
        safe = (vectors * np.maximum(values, 0.0)) @ vectors.T / TOLERANCES[:, None] / TOLERANCES[None, :]
        covariance = np.linalg.inv(safe + prior_information)
        return np.asarray(0.5 * (covariance + covariance.T))

    def _place(self, window: Window, state: se2.Array) -> PointSet:
        return place(window.returns, window.t0, state[:3], state[3:], MODEL, self._beam)

    def _far_from_keyframe(self) -> bool:
        if self._keyframe is None:
            return True
        moved = se2.between(self._keyframe, self._state[:3])
        young = min(1.0, len(self._map) / _GROWN)  # a young map is thin: it takes keyframes sooner
        far = np.hypot(moved[0], moved[1]) > young * self._settings.keyframe_m
        return bool(far or abs(moved[2]) > self._settings.keyframe_rad)

    def _add_keyframe(self, placed: PointSet) -> None:
        self._map.add(placed)
        self._keyframe = self._state[:3].copy()


def _share(found: Minimum) -> float:
    matched = found.evaluation.matched
    return float(matched.mean()) if len(matched) else 0.0
