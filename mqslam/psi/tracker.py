"""Odometry by psi over a running map: each revolution is matched to the last keyframes.

The state of a revolution is its start pose and a constant planar twist, six numbers, found by minimising psi plus the
state predicted from the revolution before. The start pose must be free: were it fixed where the last revolution ended,
errors of successive revolutions would alternate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam import se2
from mqslam.config import Config
from mqslam.errors import EstimationError
from mqslam.measurement import Status
from mqslam.motion import ACCELERATED_TWIST, CONSTANT_TWIST
from mqslam.psi.covariance import sandwich
from mqslam.psi.estimator import Evaluation, Scale, evaluate
from mqslam.psi.localmap import LocalMap
from mqslam.psi.minimiser import Minimum, Prior, minimise
from mqslam.psi.neighbours import candidates
from mqslam.psi.observability import loosened, weak_directions
from mqslam.psi.place import PointSet, place
from mqslam.psi.unsteadiness import Unsteadiness
from mqslam.psi.window import beam_of, estimate_window, search_twist
from mqslam.returns import Returns, Window

STATE_TOLERANCES = np.array([1e-3, 1e-3, 2e-5, 5e-3, 5e-3, 1e-4])  # m, m, rad, m/s, m/s, rad/s
PREDICTION_GAIN = 0.2  # variance left of psi's own once the state before has smoothed it; measured, see BENCHMARKS.md
_NOISE_PERIOD_S = 0.25  # process noise is stated per revolution of this length
_USUAL_MEMORY = 0.95  # the usual matched share forgets with this factor per revolution


@dataclass(frozen=True, slots=True)
class Tracked:
    """One revolution, matched.

    Args:
        t0: its start [s].
        state: (6,) start pose in the tracker's frame and twist.
        covariance: (6, 6) of the state, given the map, from psi's curvature.
        unsteadiness: (3,) variance of the twist that a constant twist leaves out [m^2/s^2, m^2/s^2, rad^2/s^2].
        evaluation: psi at the minimum.
        status: how far it can be trusted.
    """

    t0: float
    state: se2.Array
    covariance: NDArray[np.float64]
    unsteadiness: NDArray[np.float64]
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
        self._config = config
        self._estimator = config.estimator
        self._revolution_s = revolution_s
        self._beam = beam_of(config.estimator, config.sensor.doppler_beta)
        self._map = LocalMap(config.tracker.keyframes)
        self._state = np.zeros(6)
        self._covariance = np.zeros((6, 6))
        self._t0 = 0.0
        self._keyframe: se2.Array | None = None
        self._usual_share = 0.0
        self._unsteadiness = Unsteadiness()

    def start(self, windows: list[Window], twist: se2.Array | None) -> None:
        """Find the motion of the first revolutions from psi alone and begin the map with the first.

        Args:
            windows: the first two or three revolutions.
            twist: (3,) what odometry says, or None for an exhaustive search.

        Raises:
            EstimationError: the windows hold too few returns.
        """
        returns = Returns.concatenate([w.returns for w in windows])
        if len(returns) < 20:
            raise EstimationError(
                f"only {len(returns)} returns in the first {len(windows)} revolutions; lower detector.threshold"
            )
        t0 = windows[0].t0
        if twist is None:
            twist = self._cold_start(Returns.concatenate([w.returns for w in windows[:2]]), t0)
        model = ACCELERATED_TWIST if len(windows) > 2 else CONSTANT_TWIST
        motion = estimate_window(returns, t0, self._revolution_s, self._estimator, self._beam, twist, model)
        middle = 0.5 * self._revolution_s  # the twist of the first revolution, where the bend passes its middle
        found = np.zeros(3)
        for component, power, value in zip(model.components, model.powers, motion.theta, strict=True):
            found[component] += value * middle**power
        self._t0 = t0
        self._state = np.r_[np.zeros(3), found]
        spread = (self._config.tracker.sigma_vx, self._config.tracker.sigma_vy, self._config.tracker.sigma_omega)
        self._covariance = np.diag(np.r_[1e-8, 1e-8, 1e-12, np.square(spread)])

    def _cold_start(self, returns: Returns, t0: float) -> se2.Array:
        """The twist of the first two revolutions by exhaustive search over speed and yaw rate."""
        settings = self._config.tracker
        reach = self._estimator.s_start / 13.0  # travel per revolution that the annealing surely bridges
        speeds = np.arange(settings.speed_min, settings.speed_max + 1e-9, reach / self._revolution_s)
        limit = min(settings.omega_max, 1.0 / self._revolution_s)
        count = int(np.ceil(limit / (0.025 / self._revolution_s)))
        yaw_rates = np.linspace(-limit, limit, 2 * count + 1)
        strong = returns.intensities >= np.median(returns.intensities)
        thinned = returns.take(strong)
        twist, _ = search_twist(thinned, t0, self._revolution_s, self._estimator, self._beam, speeds, yaw_rates)
        return twist

    def first(self, window: Window) -> Tracked:
        """Take the revolution the tracker was started with as the first keyframe."""
        placed = self._place(window, self._state)
        self._add_keyframe(placed)
        empty = Evaluation(
            np.zeros(0), np.zeros(0, dtype=bool), np.zeros((0, 6)), np.zeros((6, 6)), np.zeros((6, 6))
        )
        return Tracked(window.t0, self._state, self._covariance, np.zeros(3), empty, Status.CONVERGED)

    def follow(self, window: Window, twist: se2.Array | None = None) -> Tracked:
        """Match the next revolution to the map.

        Args:
            window: one revolution.
            twist: (3,) mean twist since the last revolution according to odometry, used as a start only.
        """
        predicted, covariance = self._predict(window.t0 - self._t0)
        information = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        prior = Prior(predicted, information)
        begin = predicted
        if twist is not None:
            moved = se2.compose(self._state[:3], se2.exp(twist, window.t0 - self._t0))
            begin = np.r_[moved, twist]
        found = self._minimise(window, begin, prior)
        share = _share(found)
        status = Status.CONVERGED if share > 0.0 else Status.LOST
        if share < self._config.tracker.lost_share * self._usual_share:
            found, share, status = self._recover(window, prior, found)
        weak = weak_directions(self._evaluate(window, found.state, self._estimator.scale(0)), 3)
        if len(weak) and status is not Status.LOST:
            coasting = begin if twist is not None else predicted
            found = self._minimise(window, coasting, self._held(Prior(coasting, information), weak))
            status = Status.DEGENERATE
        if status is Status.LOST:
            self._state, self._covariance = predicted, covariance
            unsteady = self._unsteadiness.variance
            tracked = Tracked(window.t0, predicted, covariance, unsteady, found.evaluation, status)
        else:
            self._state = found.state
            self._covariance = self._posterior(found.evaluation, information)
            placed = self._place(window, found.state)
            measured = self._measured(found.evaluation, placed, covariance)
            self._unsteadiness.add(found.state[3:], np.diag(measured)[3:])
            measured[:3, :3] = loosened(measured[:3, :3], weak, self._spans)
            tracked = Tracked(
                window.t0, found.state, measured, self._unsteadiness.variance, found.evaluation, status
            )
            memory = _USUAL_MEMORY if self._usual_share > 0.0 else 0.0
            self._usual_share = memory * self._usual_share + (1.0 - memory) * share
            if self._far_from_keyframe():
                self._add_keyframe(placed)
        self._t0 = window.t0
        return tracked

    def score(self, window: Window, state: se2.Array) -> float:
        """psi of a revolution against the map under another state (6,)."""
        return self._evaluate(window, state, self._estimator.final).psi

    def _evaluate(self, window: Window, state: se2.Array, scale: Scale) -> Evaluation:
        placed, config = self._place(window, state), self._estimator
        lists = candidates(self._map.grid, placed.points, scale.s)
        return evaluate(
            placed, self._map.points, lists, scale, self._revolution_s, config.beta_t, config.xi, config.blur_m,
            moving_references=False,
        )  # fmt: skip

    def _minimise(self, window: Window, start: se2.Array, prior: Prior) -> Minimum:
        return minimise(
            start, lambda state: self._place(window, state), self._map.points, prior, self._estimator,
            self._revolution_s, STATE_TOLERANCES, self._map.grid,
        )  # fmt: skip

    def _recover(self, window: Window, prior: Prior, found: Minimum) -> tuple[Minimum, float, Status]:
        """Search around the prediction when the usual start led nowhere; keep what matches best."""
        spread = np.sqrt(np.diag(np.linalg.inv(prior.information)))
        best = found
        for ahead in np.linspace(-2.0, 2.0, 5) * max(spread[0], 1.0):
            for yaw in np.linspace(-2.0, 2.0, 5) * max(spread[2], 0.02):
                offset = np.r_[se2.compose(prior.mean[:3], [ahead, 0.0, yaw]), prior.mean[3:]]
                tried = self._minimise(window, offset, Prior(offset, prior.information))
                if tried.evaluation.psi < best.evaluation.psi:
                    best = tried
        share = _share(best)
        lost = share < self._config.tracker.lost_share * self._usual_share
        return best, share, Status.LOST if lost else Status.CONVERGED

    def _measured(
        self, found: Evaluation, placed: PointSet, predicted: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Covariance (6, 6) of the state by psi's curvature; what psi does not observe is as sure as the prediction."""
        known = np.zeros((6, 6))  # a vehicle hardly slides: without this, vy would seem as free as vx
        known[4, 4] = self._estimator.correlation / self._config.tracker.sigma_vy**2
        spread = PREDICTION_GAIN * sandwich(found, placed.points, known)
        return np.asarray(np.linalg.inv(np.linalg.inv(spread) + np.linalg.inv(predicted)))

    @property
    def _spans(self) -> NDArray[np.float64]:
        """(3,) how far a start pose may be off when nothing is known of it [m, m, rad]."""
        settings = self._config.tracker
        travel = 0.5 * max(settings.speed_max, -settings.speed_min) * self._revolution_s
        return np.array([travel, travel, settings.omega_max * self._revolution_s])

    def _held(self, prior: Prior, weak: NDArray[np.float64]) -> Prior:
        """The prior made stiff along directions (K, 3) that psi does not observe, for the pose and for the twist."""
        c, s = np.cos(prior.mean[2]), np.sin(prior.mean[2])
        to_body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        information = prior.information.copy()
        for direction in weak:
            for block, tolerance in ((slice(0, 3), direction), (slice(3, 6), to_body @ direction)):
                unit = STATE_TOLERANCES[block]
                along = tolerance / unit / np.linalg.norm(tolerance / unit) / unit
                information[block, block] += np.outer(along, along)
        return Prior(prior.mean, information)

    def _posterior(self, found: Evaluation, prior_information: NDArray[np.float64]) -> NDArray[np.float64]:
        config = self._estimator
        information = (found.curvature + config.stabiliser * found.information) / config.correlation
        values, vectors = np.linalg.eigh(information * STATE_TOLERANCES[:, None] * STATE_TOLERANCES[None, :])
        safe = (vectors * np.maximum(values, 0.0)) @ vectors.T / STATE_TOLERANCES[:, None] / STATE_TOLERANCES[None, :]
        covariance = np.linalg.inv(safe + prior_information)
        return np.asarray(0.5 * (covariance + covariance.T))

    def _predict(self, dt: float) -> tuple[se2.Array, NDArray[np.float64]]:
        """State and covariance a time dt [s] later, at the same twist."""
        settings = self._config.tracker
        step, by_twist = CONSTANT_TWIST.pose(self._state[3:], dt)
        pose = se2.compose(self._state[:3], step)
        c, s = np.cos(self._state[2]), np.sin(self._state[2])
        transition = np.eye(6)
        transition[:3, 3:] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ by_twist
        transition[:2, 2] = self._state[1] - pose[1], pose[0] - self._state[0]
        noise = np.array([
            settings.sigma_position_m, settings.sigma_position_m, settings.sigma_yaw,
            settings.sigma_vx, settings.sigma_vy, settings.sigma_omega,
        ])  # fmt: skip
        covariance = transition @ self._covariance @ transition.T + np.diag(noise**2) * (dt / _NOISE_PERIOD_S)
        return np.r_[pose, self._state[3:]], 0.5 * (covariance + covariance.T)

    def _place(self, window: Window, state: se2.Array) -> PointSet:
        return place(window.returns, window.t0, state[:3], state[3:], CONSTANT_TWIST, self._beam)

    def _far_from_keyframe(self) -> bool:
        if self._keyframe is None:
            return True
        moved = se2.between(self._keyframe, self._state[:3])
        settings = self._config.tracker
        return bool(np.hypot(moved[0], moved[1]) > settings.keyframe_m or abs(moved[2]) > settings.keyframe_rad)

    def _add_keyframe(self, placed: PointSet) -> None:
        self._map.add(placed)
        self._keyframe = self._state[:3].copy()


def _share(found: Minimum) -> float:
    matched = found.evaluation.matched
    return float(matched.mean()) if len(matched) else 0.0
