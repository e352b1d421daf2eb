"""Joins the motions of a recording that are measured in both directions of time.

Forward, a scan is matched to the scans before it; backward, to the scans after it. The two maps hold different views, so
that the errors of the two matches are nearly independent. The difference of the two measurements shows how large the errors
are, and the mean is better than either measurement. Where one direction loses the track or does not observe the motion, the
other direction often still measures the motion, and is used alone until both agree again. A recording played backward is a
valid recording, too, in which the vehicle drives in reverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.frontends.calibration import Twice, learn_scale

# Share of the variance of a motion that its measurements by psi, forward and backward in time, have in common, so that
# their difference does not show it. The true share is unknown; 0 to 0.5 was found in simulated cities.
SHARED = 0.2
# The same share for a lidar. Surfaces look the same from everywhere, and a map averages the errors of many scans. Therefore,
# most of the variance comes from the scan, which both measurements have in common: 0.79 to 0.92 in simulated rooms.
SHARED_BY_LIDAR = 0.9
_TRUST = (Status.LOST, Status.DEGENERATE, Status.AMBIGUOUS, Status.CONVERGED)  # from the least to the most trusted
_CHANCE = float(chi2.ppf(0.999, 3))  # largest squared Mahalanobis distance between two measurements that agree
_PAUSE = 0.5  # longest time between two scans, in durations of a scan, after which the second scan still follows at once


class DirectedMotion(NamedTuple):
    """A motion that was measured in one direction of time.

    Args:
        motion: the motion.
        unseen: (3, 3) part of the motion's covariance [m, m, rad] that does not come from errors of matches, but from
            directions that psi does not observe, from lost scans and from gaps.
    """

    motion: Measurement
    unseen: NDArray[np.float64]


class ReversedScans(Sequence[Scan]):
    """The scans of a recording that is played backward, the last scan first; each scan is made when it is read.

    A reversed scan begins at the start of the scan that is next in the recording, if that scan follows at once. Both
    directions then measure motions between the same instants. A scan that was taken in one instant, such as a lidar scan
    without a time per beam, keeps this instant as its start.

    Args:
        scans: the scans in the order of the recording.

    Attributes:
        end: time in the recording at which the reversed recording begins [s].
    """

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans, self._instant = scans, are_instants(scans)
        self.end = scans[-1].t1 if scans else 0.0

    def __len__(self) -> int:
        return len(self._scans)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[n] for n in range(*k.indices(len(self)))]
        n = len(self) - 1 - range(len(self))[k]
        scan, end = self._scans[n], self._scans[n].t1
        if self._instant:  # the reversed scan begins at this instant, too
            begin = self.end - scan.t0
            at_once = replace(scan.returns, times=np.full(len(scan.returns), begin))
            return Scan(begin, begin + scan.t1 - scan.t0, at_once)
        if n + 1 < len(self) and follows_at_once(scan, self._scans[n + 1]):
            end = self._scans[n + 1].t0
        r = scan.returns
        returns = Returns(r.ranges[::-1], r.azimuths[::-1], self.end - r.times[::-1], r.intensities[::-1])
        return Scan(self.end - end, self.end - scan.t0, returns)

    def turn_back(self, backward: Sequence[DirectedMotion]) -> list[DirectedMotion | None]:
        """Converts motions that were measured backward to motions forward in time, in the order of the recording.

        A motion is None where no backward motion connects the starts of its two scans: at the first scan and next to a
        pause. If each scan was taken in an instant, no motion is None.

        Args:
            backward: the N - 1 motions between the N scans, the last one first.
        """
        if self._instant:  # both directions measure motions between the same instants
            return [_invert(match) for match in reversed(backward)]
        at_once = pairwise(follows_at_once(a, b) for a, b in pairwise(self._scans))
        after_first = zip(backward[:0:-1], at_once, strict=True)
        return [None, *(_invert(match) if all(both) else None for match, both in after_first)][: len(backward)]


def are_instants(scans: Sequence[Scan]) -> bool:
    """Returns whether all returns have the start time of their scan, as in lidar scans without a time per beam."""
    seen = (scan for scan in scans if len(scan.returns) > 1)  # a single return does not show how long a scan lasts
    first = next(seen, None)
    return first is not None and all(bool(np.all(scan.returns.times == scan.t0)) for scan in chain([first], seen))


def follows_at_once(scan: Scan, after: Scan) -> bool:
    """Returns whether the scan `after` follows another scan at once, so that `after` starts where the other scan ends."""
    return abs(after.t0 - scan.t1) <= _PAUSE * (scan.t1 - scan.t0)


def _invert(match: DirectedMotion) -> DirectedMotion:
    """Returns the inverse of a motion, with the covariances of the inverse."""
    motion, unseen = match
    covariance, unseen = (se2.covariance_of_inverse(motion.pose, c) for c in (motion.covariance, unseen))
    return DirectedMotion(replace(motion, pose=se2.inverse(motion.pose), covariance=covariance), unseen)


def join(
    forward: Sequence[DirectedMotion | None],
    backward: Sequence[DirectedMotion | None],
    shared: float = SHARED,
    *,
    is_guided: bool = False,
) -> list[Measurement]:
    """Joins motions measured in both directions of time; scales covariances by how far forward and backward motions differ.

    Only the part of a covariance that psi's curvature shows is scaled, since only this part comes from errors of matches.

    Args:
        forward: the N - 1 motions between successive scans, measured forward; the result lacks motions that are None here.
        backward: the same motions, measured backward; None where there is no backward measurement.
        shared: share of the variance of a motion that both of its measurements have in common.
        is_guided: whether both directions follow odometry where psi does not show the motion.
    """
    pairs = [(f, b) for f, b in zip(forward, backward, strict=True) if f is not None]
    scale = learn_scale(_compare(f, b, shared) for f, b in pairs if b is not None)
    scaled = [(_scale(f, scale), None if b is None else _scale(b, scale)) for f, b in pairs]
    regaining = _find_regaining(scaled, shared)
    return [
        f if b is None else _join_motions(f, b, regains, shared, is_guided)
        for (f, b), regains in zip(scaled, regaining, strict=True)
    ]


def _compare(forward: DirectedMotion, backward: DirectedMotion, shared: float) -> Twice:
    """Returns the difference of two measurements of one motion, with its variances.

    The variance is NaN along an axis that one of the measurements does not observe, and along all axes if one is lost.
    `shared` is as in `join`.
    """
    f, b = forward.motion, backward.motion
    variances = (1.0 - shared) * np.diag(f.covariance + b.covariance)
    seen = [
        (np.diag(m.unseen) < 0.5 * np.diag(m.motion.covariance)) & (m.motion.status is not Status.LOST)
        for m in (forward, backward)
    ]
    return Twice(f.pose, se2.subtract(b.pose, f.pose), np.where(np.all(seen, axis=0), variances, np.nan))


def _scale(match: DirectedMotion, scale: NDArray[np.float64]) -> Measurement:
    """Scales the part of a motion's covariance that psi's curvature shows: `scale` (3,) multiplies the variances."""
    seen = match.motion.covariance - match.unseen
    return replace(match.motion, covariance=se2.scale_covariance(seen, scale) + match.unseen)


def _find_regaining(motions: Sequence[tuple[Measurement, Measurement | None]], shared: float) -> list[tuple[bool, bool]]:
    """Finds the motions in which one direction of time returns from wrong positions to right positions.

    A scan whose pose psi does not observe joins the map at its predicted pose. The scans after it, in the order of the
    track, are matched to a map that is partly wrong, and return to their right positions only step by step. These steps
    undo errors of motions that are not used, so the steps must not be used either, until both directions agree.

    Returns:
        For each motion, whether the forward direction and whether the backward direction is still returning.
    """
    agree = [b is not None and f.on_map and b.on_map and not _contradict(f, b, shared) for f, b in motions]
    there = _spread([not f.on_map for f, _ in motions], agree)
    back = _spread([b is None or not b.on_map for _, b in motions][::-1], agree[::-1])[::-1]
    return list(zip(there, back, strict=True))


def _spread(off_map: Sequence[bool], agree: Sequence[bool]) -> list[bool]:
    """Returns for each motion on the map whether it follows a motion off the map before both directions agree again.

    Args:
        off_map: whether each motion is off the map; such a motion gets False.
        agree: whether both directions agree on each motion.
    """
    spread, after = [], False
    for is_off, both_agree in zip(off_map, agree, strict=True):
        spread.append(after and not is_off and not both_agree)
        after = is_off or spread[-1]
    return spread


def _contradict(forward: Measurement, backward: Measurement, shared: float) -> bool:
    """Returns whether two measurements of a motion differ more than their covariances explain; `shared` is as in `join`."""
    apart, both = se2.subtract(backward.pose, forward.pose), forward.covariance + backward.covariance
    return bool(apart @ np.linalg.solve((1.0 - shared) * both, apart) > _CHANCE)


def _join_motions(
    forward: Measurement, backward: Measurement, regains: tuple[bool, bool], shared: float, is_guided: bool
) -> Measurement:
    """Joins two measurements of one motion, each of which is on the map if both of its scans were matched (`on_map`).

    If both measurements are on the map, the result is their mean. However, if only one of the two directions is still
    returning to its right position (`regains`), the result is the measurement of the other direction. If only one
    measurement is on the map, the result is this measurement. If neither is, `_average_alike` joins both if `is_guided`,
    else `_intersect`.
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
    return _average_alike(forward, backward) if is_guided else _intersect(forward, backward)


def _average_alike(forward: Measurement, backward: Measurement) -> Measurement:
    """Joins two measurements that follow odometry where psi does not show the motion; if one is lost, the other is used.

    In a corridor, each measurement is accurate across the corridor and inaccurate along it. By chance, the two measurements
    disagree by a small angle about the direction of the corridor: covariance intersection would put the result where two
    nearly parallel lines cross, which is anywhere along the corridor. The result is therefore the mean of both
    measurements. Its variance is at most the mean of their variances, whatever their errors have in common.
    """
    if (forward.status is Status.LOST) != (backward.status is Status.LOST):
        one = backward if forward.status is Status.LOST else forward
        return replace(one, t0=forward.t0, t1=forward.t1, psi_odometry=forward.psi_odometry)
    pose = forward.pose + 0.5 * se2.subtract(backward.pose, forward.pose)
    status = min(forward.status, backward.status, key=_TRUST.index)
    return replace(forward, pose=pose, covariance=0.5 * (forward.covariance + backward.covariance), status=status)


def _average(forward: Measurement, backward: Measurement, shared: float) -> Measurement:
    """Returns the mean of two measurements whose errors have the share `shared` of their variance in common.

    Both measurements have the same weight, whatever their covariances: if weights changed from motion to motion, errors of
    successive motions would not cancel. If the measurements contradict each other, their difference enlarges the covariance.
    """
    apart = se2.subtract(backward.pose, forward.pose)
    covariance = 0.25 * (1.0 + shared) * (forward.covariance + backward.covariance)
    if _contradict(forward, backward, shared):
        covariance = covariance + 0.25 * np.outer(apart, apart)
    return replace(forward, pose=forward.pose + 0.5 * apart, covariance=covariance, apart=apart)


def _intersect(forward: Measurement, backward: Measurement) -> Measurement:
    """Joins two measurements whose errors may be the same: half of the information of each measurement is used.

    This is covariance intersection (Julier and Uhlmann, 1997). The errors are the same, for example, where both
    measurements rest on the same odometry along a direction that psi does not observe.
    """
    gain = np.linalg.solve(forward.covariance + backward.covariance, forward.covariance).T
    covariance = 2.0 * gain @ backward.covariance
    pose = forward.pose + gain @ se2.subtract(backward.pose, forward.pose)
    status = min(forward.status, backward.status, key=_TRUST.index)
    return replace(forward, pose=pose, covariance=0.5 * (covariance + covariance.T), status=status)
