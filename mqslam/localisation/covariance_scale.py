"""The scale of localised covariances: scans that share nothing are laid on halves of the map that share nothing.

The covariance of psi's curvature is too small by a factor that depends on the world: returns of one object move together as
it is seen from elsewhere, and keyframes err within the map. Two scans that are some metres apart, each laid on one half of
the keyframes around it, differ by the errors of both, besides that of the short way between them. Where the front end's
motions are poor, the factor is too large rather than too small.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.align import TOLERANCES
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.statistics.chances import find_usual_scale
from mqslam.localisation.localised import PlaceStatus
from mqslam.localisation.registering import MapAround, Prediction, Registered, register
from mqslam.localisation.scan_by_scan import LocalisedScans, Setting
from mqslam.mapping.keyframing import pick_spaced

# Path [m] between the scans that show by which factors the covariances are too small.
_SAMPLE_M = 20.0
# Path [m] between two scans that are laid on keyframes which they do not share, to see how far they disagree. Over a shorter
# path they see the same side of everything and err alike, over a longer one the motions between them err, too.
_APART_M = 5.0
# With fewer such pairs the recording does not show these factors.
FEWEST_PAIRS = 20
# Factor on the variances of psi's curvature where the recording is too short to show it. Drives through cities have shown 6
# to 13.
_USUAL_SCALE = 10.0

_BATCH: Final = 64  # pairs that one call compares: a matter of speed only


def measure_scale(setting: Setting, table: LocalisedScans, engine: Engine) -> tuple[NDArray[np.float64], int]:
    """Returns the factors (3,) that psi's variances need, and the number of pairs of scans that show them.

    Args:
        setting: what the scans were followed with.
        table: where each lies in the map.
        engine: where pairs are compared; the result does not depend on it.
    """
    travelled = setting.drive.travelled
    converged = np.array([status is PlaceStatus.CONVERGED for status in table.statuses], dtype=np.bool_)
    pairs = []
    for k in pick_spaced(travelled, _SAMPLE_M).tolist():
        n = int(np.searchsorted(travelled, travelled[k] + _APART_M))
        if n < len(travelled) and converged[k : n + 1].all() and travelled[n] - travelled[k] <= 2.0 * _APART_M:
            pairs.append((k, n))
    lying = [
        ((k, Prediction(table.poses[k], table.covariances[k])), (n, Prediction(table.poses[n], table.covariances[n])))
        for k, n in pairs
    ]
    batches = [lying[begin : begin + _BATCH] for begin in range(0, len(lying), _BATCH)]
    parts = engine.map(_compare, setting, batches)
    squares = np.concatenate([np.empty((0, 3)), *parts])
    if len(squares) < FEWEST_PAIRS:
        return np.full(3, _USUAL_SCALE), len(squares)
    return find_usual_scale(squares), len(squares)


def _compare(setting: Setting, pairs: list[tuple[tuple[int, Prediction], tuple[int, Prediction]]]) -> NDArray[np.float64]:
    """Returns the squares (K, 3) by which pairs of scans disagree, in units of the variances of psi's curvature."""
    even = np.arange(len(setting.keyframes)) % 2 == 0
    halves = [MapAround(setting.keyframes, setting.beam, chosen) for chosen in (even, ~even)]
    squares = []
    for pair in pairs:
        first, second = (_lay(setting, half, *one) for half, one in zip(halves, pair, strict=True))
        if not first.status == second.status == PlaceStatus.CONVERGED:
            continue
        step = se2.between(*(setting.drive.poses[k] for k, _ in pair))
        off = se2.wrapped_between(se2.compose(first.pose, step), second.pose)
        back = se2.adjoint(se2.inverse(step))
        squares.append(off**2 / np.diag(back @ first.covariance @ back.T + second.covariance))
    return np.array(squares).reshape(-1, 3)


def _lay(setting: Setting, half: MapAround, k: int, expected: Prediction) -> Registered:
    """Returns where a scan lies on half of the map, of which it is expected where it lies on all of it."""
    roughly = Prediction(expected.pose, expected.covariance + np.diag(TOLERANCES**2))
    return register(half, setting.render(k), roughly, setting.estimator)
