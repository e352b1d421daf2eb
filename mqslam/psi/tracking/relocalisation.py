"""Where the track goes on after a gap or a loss: the scan there is tracked from both sides of the gap.

The scans after the gap show how fast the sensor moved at its end, those before it at its start; between the two it moved as
the process noise allows. Only a match that is sure and without a rival in that whole region ties the two sides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum
from mqslam.psi.tracking.cold_start import FirstMotion, find_first_motion
from mqslam.psi.tracking.dynamics import LONGEST_COAST_S, correct_motion, replace_motion
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.plausibility import is_usable
from mqslam.psi.tracking.setup import Setup
from mqslam.psi.tracking.state import Belief, State

# Standard deviation of a distance travelled across a gap, as a share of that distance. Published lengths of one radar's
# range bins differ by 1.4 %, and a Doppler shift that is ignored costs as much.
_SIGMA_SCALE = 0.01

IsPoor = Callable[[float], bool]  # whether a matched share is much poorer than usual


def find_motion_after(scans: Sequence[Scan], predicted: Belief, setup: Setup, is_poor: IsPoor) -> FirstMotion | None:
    """Finds the motion of the scans after a gap from themselves; returns None where they do not show it."""
    if len(scans) < 2 or not all(is_usable(scan) for scan in scans):
        return None
    for begin in (predicted.mean.twist, None):  # the exhaustive search costs much more
        first = find_first_motion(scans, setup, begin)
        if first.observed and not is_poor(first.matched):
            return first
    return None


def bridge_gap(predicted: Belief, dt: float, after: FirstMotion | None) -> Belief:
    """Joins what is predicted across a gap of dt [s] with the motion found after it, if there is one."""
    if after is None:
        return predicted
    if dt <= LONGEST_COAST_S:
        return correct_motion(predicted, after.motion, after.covariance)
    # what comes before a pause or a jump of the clock does not show where its end is
    return replace_motion(predicted, after.motion, after.covariance)


def place_by_odometry(belief: Belief, before: se2.Array, twist: se2.Array | None, dt: float) -> Belief:
    """Returns the belief at the pose that odometry's mean twist (3,) reaches from a pose (3,) in dt [s], if there is any."""
    if twist is None:
        return belief
    pose = se2.compose(before, se2.exp(twist, dt))
    return Belief(State.of(pose, belief.mean.motion), belief.covariance)


def find_again(
    scan: Scan, bridged: Belief, into: LocalMap, matcher: Matcher, is_out_of_place: Callable[[Minimum], bool]
) -> tuple[Minimum, bool]:
    """Finds a scan in the whole region that the other side of a gap allows.

    Returns:
        the best match, and whether it ties the two sides: it is sure, it has no rival, and the map shows every direction.
    """
    direct = matcher.minimise(scan, bridged.mean, bridged.prior, into)
    match = matcher.search(scan, bridged, into, [direct])
    if match.rivalled or is_out_of_place(match.minimum):
        return match.minimum, False
    return match.minimum, not len(matcher.find_weak_directions(scan, State(match.minimum.state), into))


def estimate_arrival(begin: se2.Array, end: se2.Array) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) of a match across a gap besides psi's: the sensor's scale enters with the distance."""
    distance = float(np.hypot(*(end - begin)[:2]))
    return np.diag([(_SIGMA_SCALE * distance) ** 2] * 2 + [0.0])
