"""A scan laid into the map: the keyframes around a prediction are held, and psi finds the scan's pose among them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import TOLERANCES, score_at_pose
from mqslam.backend.loops.rigid import ANY_TIME, minimise_rigidly, move_rigidly
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.localisation.localised import PlaceStatus
from mqslam.mapping.keyframing import place_keyframes
from mqslam.psi.covariance import estimate_covariance, find_weak_directions, spread_along
from mqslam.psi.minimiser import annealed_scale, kernel_of
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import References, evaluate, make_references

# The keyframes around the vehicle are chosen anew once it has moved this far [m]. More of it is faster, and lays scans on
# keyframes that are less well centred around them.
_RENEW_M = 2.5

# A scan is compared with the map's keyframes within this distance of it [m].
REACH_M = 15.0
# Least share of a scan's returns that must lie on the map. Parked cars and traffic that have changed since the map was made
# take away from it.
_MATCHED = 0.5
# A scan that psi moves farther than this [m] from its prediction is not believed; what the prediction may have drifted is
# added.
_ASIDE_M = 0.5
# Standard deviations of the prediction that are added to _ASIDE_M and _ASIDE_RAD.
_SIGMAS = 3.0
# Yaw [rad] beyond which a scan is not believed in the same way.
_ASIDE_RAD = 0.03

_FIRST_STEP: Final = 2  # step of the annealing to begin with: a prediction is nearer than the first widths

_LEAST: Final = np.diag(TOLERANCES**2)
"""Covariance that a search leaves by where it ends: numerical."""


class Prediction(NamedTuple):
    """Where a scan is expected.

    Args:
        pose: (3,) in the map's frame [m, m, rad].
        covariance: (3, 3) of the pose in its own frame.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]


class Registered(NamedTuple):
    """Where a scan lies in the map.

    Args:
        pose: (3,) in the map's frame [m, m, rad].
        covariance: (3, 3) of the pose in its own frame.
        status: how far the pose can be trusted.
        psi: score per return; NaN where the scan does not lie on the map.
        matched: share of the returns that lie on the map; NaN where the scan was not compared with it.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]
    status: PlaceStatus
    psi: float
    matched: float


class MapAround:
    """The keyframes around the vehicle as references, which serve until it has moved on.

    Args:
        keyframes: of the map.
        beam: the sensor's errors.
        chosen: (K,) which keyframes are used; None takes all.
    """

    def __init__(self, keyframes: Keyframes, beam: Beam, chosen: NDArray[np.bool_] | None = None) -> None:
        self._keyframes, self._beam = keyframes, beam
        self._numbers = np.arange(len(keyframes)) if chosen is None else np.flatnonzero(chosen)
        self._tree = cKDTree(keyframes.poses[self._numbers, :2])
        self._frame = np.full(3, np.inf)
        self._references: References | None = None

    def find(self, pose: se2.Array) -> tuple[se2.Array, References] | None:
        """Returns a frame (3,) near a pose (3,), which is not turned, and the map around it in this frame.

        Args:
            pose: of the scan in the map's frame.

        Returns:
            None where the map has no keyframe within reach.
        """
        if np.hypot(*(pose - self._frame)[:2]) > _RENEW_M:
            self._frame = np.array([pose[0], pose[1], 0.0])
            near = np.sort(self._tree.query_ball_point(pose[:2], REACH_M)).astype(np.int64)
            self._references = None
            if len(near):
                chosen = self._numbers[near]
                points = place_keyframes(self._keyframes, chosen, self._frame, self._keyframes.poses, self._beam)
                self._references = make_references(points)
        return None if self._references is None else (self._frame, self._references)


def register(around: MapAround, scan: PointSet, prediction: Prediction, config: EstimatorConfig) -> Registered:
    """Lays a scan into the map.

    Args:
        around: the map.
        scan: its returns in the frame of its start.
        prediction: where it is expected.
        config: settings of the score.
    """
    found = around.find(prediction.pose)
    if found is None:
        return Registered(*prediction, PlaceStatus.OUTSIDE, np.nan, np.nan)
    if not len(scan):
        return Registered(*prediction, PlaceStatus.LOST, np.nan, np.nan)
    frame, references = found
    guess = se2.between(frame, prediction.pose)
    minimum = minimise_rigidly(guess, scan, references, config, TOLERANCES, _FIRST_STEP)
    moved = se2.wrapped_between(guess, minimum.state)
    matched = float(minimum.evaluation.matched.mean())
    if matched < _MATCHED or is_away(moved, prediction):
        return Registered(*prediction, PlaceStatus.LOST, np.nan, matched)
    points = move_rigidly(scan, minimum.state)
    own = se2.rotate_covariance(
        estimate_covariance(minimum.evaluation, points.points, config.cluster_m), -float(minimum.state[2])
    )
    own = own + _LEAST
    weak = find_weak_directions(evaluate(points, references, annealed_scale(config, 0), kernel_of(config, ANY_TIME)), 3)
    if not len(weak):
        return Registered(
            se2.compose(frame, minimum.state), own, PlaceStatus.CONVERGED, minimum.evaluation.psi / len(scan), matched
        )
    spread = spread_along(weak, np.array([REACH_M, REACH_M, np.pi]))
    pose, covariance = _join(Prediction(guess, prediction.covariance), minimum.state, own, spread)
    psi = score_at_pose(references, scan, pose, config)
    return Registered(se2.compose(frame, pose), covariance, PlaceStatus.DEGENERATE, psi, matched)


def is_away(moved: se2.Array, prediction: Prediction) -> bool:
    """Returns whether a pose lies farther from a prediction than the prediction may be off.

    Args:
        moved: (3,) the pose in the frame of the predicted one.
        prediction: the prediction.
    """
    sigmas = np.sqrt(np.diag(prediction.covariance))
    allowed_m = _ASIDE_M + _SIGMAS * float(np.hypot(sigmas[0], sigmas[1]))
    allowed_rad = _ASIDE_RAD + _SIGMAS * float(sigmas[2])
    return bool(np.hypot(moved[0], moved[1]) > allowed_m or abs(moved[2]) > allowed_rad)


def _join(
    prediction: Prediction, measured: se2.Array, covariance: NDArray[np.float64], spread: NDArray[np.float64]
) -> tuple[se2.Array, NDArray[np.float64]]:
    """Returns a pose (3,) that follows its prediction where psi does not hold it, and its covariance in its own frame.

    Args:
        prediction: of the pose, in the frame that psi has measured it in.
        measured: (3,) the pose at psi's minimum.
        covariance: (3, 3) of that in its own frame, as far as psi holds it.
        spread: (3, 3) covariance along the directions that psi does not hold, in the frame that it is measured in.
    """
    expected = se2.rotate_covariance(prediction.covariance + _LEAST, float(prediction.pose[2]))
    seen = se2.rotate_covariance(covariance, float(measured[2])) + spread
    gain = np.linalg.solve((expected + seen).T, expected.T).T
    off = measured - prediction.pose
    off[2] = se2.wrap(off[2])
    pose = prediction.pose + gain @ off
    left = expected - gain @ expected
    return pose, se2.rotate_covariance(0.5 * (left + left.T), -float(pose[2]))
