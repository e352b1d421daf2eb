"""Registers a scan on the map: the keyframes around its predicted pose stay fixed, and psi finds the scan's pose."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.registration import score_among, score_at_pose
from mqslam.backend.loops.rigid import LEAST_COVARIANCE, minimise_rigidly, move_rigidly
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.mapping.keyframing import place_keyframes
from mqslam.psi.covariance import estimate_covariance, find_weak_directions, spread_along
from mqslam.psi.minimiser import annealed_scale
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import References, make_references

# The keyframes around the vehicle are selected again once it has moved this far [m]. A longer distance saves time, but then
# scans are registered on keyframes that are less well centred around them.
_RENEW_M = 2.5

# A scan is compared with the keyframes within this distance of its pose [m].
REACH_M = 15.0
# Least share of a scan's returns that must lie on the map. Traffic, and cars parked elsewhere than when the map was made,
# lower the share.
_MATCHED = 0.5
# A registration that ends farther than this [m] from the prediction is rejected. The uncertainty of the prediction is added
# to this limit.
_ASIDE_M = 0.5
# Number of the prediction's standard deviations that are added to _ASIDE_M and to _ASIDE_RAD.
_SIGMAS = 3.0
# Like _ASIDE_M, for the yaw [rad].
_ASIDE_RAD = 0.03

_FIRST_STEP: Final = 2  # number of the first annealing step: earlier, wider steps are for starts farther off


class PlaceStatus(StrEnum):
    """How far the pose of a scan in the map can be trusted."""

    CONVERGED = "converged"
    DEGENERATE = "degenerate"  # the map does not show one direction: the pose is a prediction along it
    LOST = "lost"  # too little of the scan lies on the map: the pose is a prediction
    OUTSIDE = "outside"  # the map has nothing there: the pose is a prediction


ON_MAP = (PlaceStatus.CONVERGED, PlaceStatus.DEGENERATE)
"""The statuses of scans that lie on the map."""


class Registered(NamedTuple):
    """The pose of a scan in the map, registered or predicted.

    Args:
        pose: (3,) pose in the map's frame [m, m, rad].
        covariance: (3, 3) covariance of the pose in its own frame [m, m, rad].
        status: how far the pose can be trusted.
        psi: score per return; NaN where the scan does not lie on the map.
        matched: share of the returns that lie on the map; NaN where the scan was not compared with it.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]
    status: PlaceStatus = PlaceStatus.LOST
    psi: float = float("nan")
    matched: float = float("nan")


class MapAround:
    """The keyframes around the vehicle, on which its scans are registered; they are selected anew as the vehicle moves on.

    Args:
        keyframes: keyframes of the map.
        beam: the sensor's measurement errors.
        chosen: (K,) whether each keyframe may be used; None allows all.
    """

    def __init__(self, keyframes: Keyframes, beam: Beam, chosen: NDArray[np.bool_] | None = None) -> None:
        self._keyframes, self._beam = keyframes, beam
        self._numbers = np.arange(len(keyframes)) if chosen is None else np.flatnonzero(chosen)
        self._tree = cKDTree(keyframes.poses[self._numbers, :2])
        self._frame = np.full(3, np.inf)
        self._references: References | None = None

    def find(self, pose: se2.Array) -> tuple[se2.Array, References] | None:
        """Returns the map's points around a scan in a local frame, or None if the map has no keyframe within reach.

        Args:
            pose: (3,) pose of the scan in the map's frame [m, m, rad].

        Returns:
            The local frame (3,) [m, m, rad], near the scan and parallel to the map's frame, and the points in it.
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


def register(around: MapAround, scan: PointSet, prediction: Registered, config: EstimatorConfig) -> Registered:
    """Registers a scan on the map; if this fails, returns the predicted pose with the status LOST or OUTSIDE.

    Along directions that psi does not observe, the registered pose is the predicted one (status DEGENERATE).

    Args:
        around: the map around the vehicle.
        scan: returns of the scan in the frame of its start pose.
        prediction: the predicted pose of the scan, with its covariance.
        config: settings of the score.
    """
    expected = Registered(prediction.pose, prediction.covariance)
    found = around.find(prediction.pose)
    if found is None:
        return expected._replace(status=PlaceStatus.OUTSIDE)
    if not len(scan):
        return expected
    frame, references = found
    guess = se2.between(frame, prediction.pose)
    minimum = minimise_rigidly(guess, scan, references, config, _FIRST_STEP)
    matched = minimum.evaluation.overlap
    if matched < _MATCHED or is_away(se2.wrapped_between(guess, minimum.state), prediction):
        return expected._replace(matched=matched)
    points = move_rigidly(scan, minimum.state)
    own = estimate_covariance(minimum.evaluation, points.points, config.cluster_m)
    own = se2.rotate_covariance(own, -float(minimum.state[2])) + LEAST_COVARIANCE
    weak = find_weak_directions(score_among(references, points, config, annealed_scale(config, 0)), 3)
    if not len(weak):
        psi = minimum.evaluation.psi / len(scan)
        return Registered(se2.compose(frame, minimum.state), own, PlaceStatus.CONVERGED, psi, matched)
    spread = spread_along(weak, np.array([REACH_M, REACH_M, np.pi]))
    pose, covariance = _join(Registered(guess, prediction.covariance), minimum.state, own, spread)
    psi = score_at_pose(references, scan, pose, config)
    return Registered(se2.compose(frame, pose), covariance, PlaceStatus.DEGENERATE, psi, matched)


def is_away(moved: se2.Array, prediction: Registered) -> bool:
    """Returns whether a pose is too far from its prediction to be accepted.

    `moved` (3,) is the pose in the frame of the predicted pose [m, m, rad]. The limits are `_ASIDE_M` and `_ASIDE_RAD`, each
    plus `_SIGMAS` standard deviations of the prediction.
    """
    sigmas = np.sqrt(np.diag(prediction.covariance))
    allowed_m = _ASIDE_M + _SIGMAS * float(np.hypot(sigmas[0], sigmas[1]))
    allowed_rad = _ASIDE_RAD + _SIGMAS * float(sigmas[2])
    return bool(np.hypot(moved[0], moved[1]) > allowed_m or abs(moved[2]) > allowed_rad)


def _join(
    prediction: Registered, measured: se2.Array, covariance: NDArray[np.float64], spread: NDArray[np.float64]
) -> tuple[se2.Array, NDArray[np.float64]]:
    """Fuses a measured pose with its prediction, which alone determines the directions that psi does not observe.

    Args:
        prediction: the predicted pose, in the local frame of the registration, with its covariance.
        measured: (3,) pose at psi's minimum, in the same frame.
        covariance: (3, 3) covariance of the measured pose in its own frame, without the directions that psi does not
            observe.
        spread: (3, 3) covariance along the directions that psi does not observe, in the local frame of the registration.

    Returns:
        The fused pose (3,) in the local frame [m, m, rad], and its covariance (3, 3) in the pose's own frame.
    """
    expected = se2.rotate_covariance(prediction.covariance + LEAST_COVARIANCE, float(prediction.pose[2]))
    seen = se2.rotate_covariance(covariance, float(measured[2])) + spread
    gain = np.linalg.solve((expected + seen).T, expected.T).T
    pose = prediction.pose + gain @ se2.subtract(measured, prediction.pose)
    left = expected - gain @ expected
    return pose, se2.rotate_covariance(0.5 * (left + left.T), -float(pose[2]))
