"""A recording tracked in both directions of time, and what both say of one motion.

Forward, a scan is matched to what was seen before it; backward, to what was seen after it. The two maps hold other views,
so that the errors of the two matches are nearly independent: how far the two are apart shows how large their errors are,
and their mean is better than either. Where one direction loses the track or observes nothing, the other often does not: it
then counts alone until both agree again. A recording played backward is a recording too: the vehicle drives in reverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.frontends.calibration import Twice, learn_scale

# Share of the variance of a motion that its measurements by psi, forward and backward in time, have in common, so that how
# far they are apart does not show it. It is unknown; 0 to 0.5 was found in simulated cities.
SHARED = 0.2
_TRUST = (Status.LOST, Status.DEGENERATE, Status.AMBIGUOUS, Status.CONVERGED)  # from the least to the most
_CHANCE = float(chi2.ppf(0.999, 3))  # measurements that are farther apart, in their own covariance, contradict each other
_PAUSE = 0.5  # time between two scans, in turns, beyond which the end of one is not the start of the next


class DirectedMotion(NamedTuple):
    """A motion that was measured in one direction of time.

    Args:
        motion: the motion.
        unseen: (3, 3) the part of its covariance that is no error of a match: of directions that psi does not observe, of
            scans that it did not find, of gaps.
    """

    motion: Measurement
    unseen: NDArray[np.float64]


class ReversedScans(Sequence[Scan]):
    """Scans as if the recording were played backward, the last one first; each is made when it is asked for.

    A scan that the next one follows at once begins, in the new time, where that one ends, so that both directions measure
    the motion between the same instants.

    Args:
        scans: two or more.
    """

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans, self._end = scans, scans[-1].t1

    def __len__(self) -> int:
        return len(self._scans)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[n] for n in range(*k.indices(len(self)))]
        n = len(self) - 1 - range(len(self))[k]
        scan, end = self._scans[n], self._scans[n].t1
        if n + 1 < len(self) and follows_at_once(scan, self._scans[n + 1]):
            end = self._scans[n + 1].t0
        r = scan.returns
        returns = Returns(r.ranges[::-1], r.azimuths[::-1], self._end - r.times[::-1], r.intensities[::-1])
        return Scan(self._end - end, self._end - scan.t0, returns)


def follows_at_once(scan: Scan, after: Scan) -> bool:
    """Returns whether a scan follows another one at once, so that the end of one is the start of the other."""
    return abs(after.t0 - scan.t1) <= _PAUSE * (scan.t1 - scan.t0)


def turn_back(scans: Sequence[Scan], backward: Sequence[DirectedMotion]) -> list[DirectedMotion | None]:
    """Returns motions that were measured backward as those that were driven, in the order of the recording.

    There is none, and None in its place, where no backward motion leads to the start of a scan from the end of the next:
    at the first scan and beside a pause.

    Args:
        scans: the N scans.
        backward: the N - 1 motions between them in the order of `ReversedScans`.
    """
    at_once = [follows_at_once(a, b) for a, b in pairwise(scans)]
    turned: list[DirectedMotion | None] = []
    for k in range(len(backward)):
        if k == 0 or not (at_once[k - 1] and at_once[k]):
            turned.append(None)
            continue
        motion, unseen = backward[len(backward) - k]
        covariance, unseen = (se2.covariance_of_inverse(motion.pose, c) for c in (motion.covariance, unseen))
        turned.append(DirectedMotion(replace(motion, pose=se2.inverse(motion.pose), covariance=covariance), unseen))
    return turned


def join(
    forward: Sequence[DirectedMotion | None], backward: Sequence[DirectedMotion | None], shared: float = SHARED
) -> list[Measurement]:
    """Joins motions that were measured in both directions of time, with covariances that show how far the two are apart.

    Only what psi's curvature shows is scaled so. How little is known of what psi did not observe is no matter of errors of
    matches.

    Args:
        forward: the N - 1 motions between successive scans.
        backward: the same motions, measured backward, or None.
        shared: share of the variance of a motion that both of its measurements have in common.
    """
    pairs = [(f, b) for f, b in zip(forward, backward, strict=True) if f is not None]
    scale = learn_scale(_compare(f, b, shared) for f, b in pairs if b is not None)
    scaled = [(_scale(f, scale), None if b is None else _scale(b, scale)) for f, b in pairs]
    regaining = _find_regaining(scaled, shared)
    return [
        f if b is None else _join_motions(f, b, regains, shared) for (f, b), regains in zip(scaled, regaining, strict=True)
    ]


def _compare(forward: DirectedMotion, backward: DirectedMotion, shared: float) -> Twice:
    """Returns how far two measurements of one motion are apart along the axes of which psi's curvature tells both."""
    f, b = forward.motion, backward.motion
    variances = (1.0 - shared) * np.diag(f.covariance + b.covariance)
    seen = [
        (np.diag(m.unseen) < 0.5 * np.diag(m.motion.covariance)) & (m.motion.status is not Status.LOST)
        for m in (forward, backward)
    ]
    return Twice(f.pose, se2.subtract(b.pose, f.pose), np.where(np.all(seen, axis=0), variances, np.nan))


def _scale(match: DirectedMotion, scale: NDArray[np.float64]) -> Measurement:
    """Returns a motion whose variances (3,) of x, y and yaw are scaled as far as psi's curvature shows them."""
    seen = match.motion.covariance - match.unseen
    return replace(match.motion, covariance=se2.scale_covariance(seen, scale) + match.unseen)


def _find_regaining(motions: Sequence[tuple[Measurement, Measurement | None]], shared: float) -> list[tuple[bool, bool]]:
    """Finds the motions over which a direction has not yet found back to the place that it was held away from.

    A scan that psi does not observe is held where it was predicted, and joins the map there. The scans after it, in the
    order of the track, are matched to a map that is partly wrong, and come back to their places only step by step. These
    steps make up for motions that do not count, so that they must not count either, until both directions agree. The result
    says of each motion whether the forward and the backward direction regain their places over it.
    """
    agree = [b is not None and f.on_map and b.on_map and not _contradict(f, b, shared) for f, b in motions]
    there = _spread([not f.on_map for f, _ in motions], agree)
    back = _spread([b is None or not b.on_map for _, b in motions][::-1], agree[::-1])[::-1]
    return list(zip(there, back, strict=True))


def _spread(held: Sequence[bool], agree: Sequence[bool]) -> list[bool]:
    """Returns which motions come, in the order given, after a held one and before one on which both directions agree."""
    spread, after = [], False
    for is_held, both_agree in zip(held, agree, strict=True):
        spread.append(after and not is_held and not both_agree)
        after = is_held or spread[-1]
    return spread


def _contradict(forward: Measurement, backward: Measurement, shared: float) -> bool:
    """Returns whether two measurements of one motion are farther apart than their covariances explain."""
    apart, both = se2.subtract(backward.pose, forward.pose), forward.covariance + backward.covariance
    return bool(apart @ np.linalg.solve((1.0 - shared) * both, apart) > _CHANCE)


def _join_motions(forward: Measurement, backward: Measurement, regains: tuple[bool, bool], shared: float) -> Measurement:
    """Returns what two measurements of one motion say together; one whose scans were both matched counts alone.

    A direction that regains its place over this motion leaves it to the other one, if that does not.
    """
    there, back = forward.on_map, backward.on_map
    if there and back and regains[0] != regains[1]:
        there, back = regains[1], regains[0]
    if there and back:
        return _average(forward, backward, shared)
    if there:
        return forward
    if back:
        return replace(backward, t0=forward.t0, t1=forward.t1, psi_odometry=forward.psi_odometry)
    return _intersect(forward, backward)


def _average(forward: Measurement, backward: Measurement, shared: float) -> Measurement:
    """Returns the mean of two measurements whose errors have a share of their variance in common.

    Each counts as much as the other, whatever its covariance: weights that change from motion to motion would keep errors
    of successive motions from cancelling. Two measurements that contradict each other are less sure than they say.
    """
    apart = se2.subtract(backward.pose, forward.pose)
    covariance = 0.25 * (1.0 + shared) * (forward.covariance + backward.covariance)
    if _contradict(forward, backward, shared):
        covariance = covariance + 0.25 * np.outer(apart, apart)
    return replace(forward, pose=forward.pose + 0.5 * apart, covariance=covariance, apart=apart)


def _intersect(forward: Measurement, backward: Measurement) -> Measurement:
    """Returns what two measurements say together whose errors may be one: half of the information of each.

    This is covariance intersection (Julier and Uhlmann, 1997). Along a direction that psi does not observe, both may rest
    on the same odometry.
    """
    gain = np.linalg.solve(forward.covariance + backward.covariance, forward.covariance).T
    covariance = 2.0 * gain @ backward.covariance
    pose = forward.pose + gain @ se2.subtract(backward.pose, forward.pose)
    status = min(forward.status, backward.status, key=_TRUST.index)
    return replace(forward, pose=pose, covariance=0.5 * (covariance + covariance.T), status=status)
