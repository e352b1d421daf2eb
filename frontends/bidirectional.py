"""A recording tracked in both directions of time, and what both say of one motion.

Forward, a scan is matched to what was seen before it; backward, to what was seen after it. The two maps hold other views,
so that the errors of the two matches are nearly independent: how far the two are apart shows how large their errors are,
and their mean is better than either. Where one direction loses the track or observes nothing, the other often does not: it
then counts alone until both agree again. A recording played backward is a recording too: the vehicle drives in reverse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, overload

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


class MatchTable(list[DirectedMotion | None]):
    """Matches of successive motions, or None where there is none."""

    def extend(self, matches: Iterable[DirectedMotion | None], begin: int | None = None) -> None:
        """Appends matches, in the place of those from number `begin` on if it is given."""
        if begin is not None:
            del self[begin:]
        super().extend(matches)


def reverse_time(scans: Sequence[Scan]) -> Sequence[Scan]:
    """Returns the scans as if the recording were played backward, the last one first.

    A scan that the next one follows at once begins, in the new time, where that one ends, so that both directions measure
    the motion between the same instants.

    Args:
        scans: two or more.
    """
    return _Reversed(scans)


class _Reversed(Sequence[Scan]):
    """Scans played backward, each made when it is asked for."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans, self._end = scans, scans[-1].t1

    def __len__(self) -> int:
        return len(self._scans)

    @overload
    def __getitem__(self, k: int) -> Scan: ...

    @overload
    def __getitem__(self, k: slice) -> list[Scan]: ...

    def __getitem__(self, k: int | slice) -> Scan | list[Scan]:
        if isinstance(k, slice):
            return [self[n] for n in range(*k.indices(len(self)))]
        n = len(self) - 1 - range(len(self))[k]
        scan, after = self._scans[n], self._scans[n + 1] if n + 1 < len(self) else None
        returns = _reverse_returns(scan.returns, self._end)
        return Scan(self._end - _find_end(scan, after), self._end - scan.t0, returns)


def turn_back(scans: Sequence[Scan], backward: Sequence[DirectedMotion | None]) -> MatchTable:
    """Returns motions that were measured backward as those that were driven, in the order of the recording.

    There is none, and None in its place, where no backward motion leads to the start of a scan from the end of the next:
    at the first scan and beside a pause.

    Args:
        scans: the N scans.
        backward: the N - 1 motions between them in the order of `reverse_time`.
    """
    count, at_once = len(backward), [follows_at_once(a, b) for a, b in pairwise(scans)]
    has_one = (k > 0 and at_once[k - 1] and at_once[k] for k in range(count))
    matches = (backward[count - k] if is_there else None for k, is_there in enumerate(has_one))
    return MatchTable(None if match is None else _turn(match) for match in matches)


def join(
    forward: Sequence[DirectedMotion | None], backward: Sequence[DirectedMotion | None], shared: float = SHARED
) -> Sequence[Measurement]:
    """Joins motions that were measured in both directions of time, with covariances that show how far the two are apart.

    Only what psi's curvature shows is scaled so. How little is known of what psi did not observe is no matter of errors of
    matches.

    Args:
        forward: the N - 1 motions between successive scans.
        backward: the same motions, measured backward, or None.
        shared: share of the variance of a motion that both of its measurements have in common.
    """
    twice = (_compare(f, b, shared) for f, b in _pair(forward, backward) if b is not None)
    scale = learn_scale(twice)

    def scaled() -> Iterator[tuple[Measurement, Measurement | None]]:
        for f, b in _pair(forward, backward):
            yield _scale(f, scale), None if b is None else _scale(b, scale)

    regaining = _find_regaining(scaled(), shared)
    return [
        f if b is None else _join_motions(f, b, regains, shared) for (f, b), regains in zip(scaled(), regaining, strict=True)
    ]


def _pair(
    forward: Sequence[DirectedMotion | None], backward: Sequence[DirectedMotion | None]
) -> Iterator[tuple[DirectedMotion, DirectedMotion | None]]:
    """Yields the matches of the same motions in both directions of time; every motion has a forward one."""
    for f, b in zip(forward, backward, strict=True):
        if f is not None:
            yield f, b


def follows_at_once(scan: Scan, after: Scan) -> bool:
    """Returns whether a scan follows another one at once, so that the end of one is the start of the other."""
    return abs(after.t0 - scan.t1) <= _PAUSE * (scan.t1 - scan.t0)


def _compare(forward: DirectedMotion, backward: DirectedMotion, shared: float) -> Twice:
    """Returns how far two measurements of one motion are apart along the axes of which psi's curvature tells both."""
    f, b = forward.motion, backward.motion
    variances = (1.0 - shared) * np.diag(f.covariance + b.covariance)
    told = [
        (np.diag(m.unseen) < 0.5 * np.diag(m.motion.covariance)) & (m.motion.status is not Status.LOST)
        for m in (forward, backward)
    ]
    return Twice(f.pose, se2.subtract(b.pose, f.pose), np.where(np.all(told, axis=0), variances, np.nan))


def _scale(match: DirectedMotion, scale: NDArray[np.float64]) -> Measurement:
    """Returns a motion whose variances (3,) of x, y and yaw are scaled as far as psi's curvature shows them."""
    seen = match.motion.covariance - match.unseen
    return replace(match.motion, covariance=se2.scale_covariance(seen, scale) + match.unseen)


def _find_end(scan: Scan, after: Scan | None) -> float:
    """Returns when a scan ends [s]: at the start of the next one, if that follows at once."""
    return after.t0 if after is not None and follows_at_once(scan, after) else scan.t1


def _reverse_returns(returns: Returns, end: float) -> Returns:
    """Returns the returns of a scan in the order of a time that begins at `end` [s] and runs backward."""
    return Returns(returns.ranges[::-1], returns.azimuths[::-1], end - returns.times[::-1], returns.intensities[::-1])


def _turn(match: DirectedMotion) -> DirectedMotion:
    """Returns a motion that was measured backward as the one that was driven."""
    motion, pose = match.motion, match.motion.pose
    covariance, unseen = (se2.covariance_of_inverse(pose, c) for c in (motion.covariance, match.unseen))
    return DirectedMotion(replace(motion, pose=se2.inverse(pose), covariance=covariance), unseen)


def _find_regaining(motions: Iterable[tuple[Measurement, Measurement | None]], shared: float) -> list[tuple[bool, bool]]:
    """Finds the motions over which a direction has not yet found back to the place that it was held away from.

    A scan that psi does not observe is held where it was predicted, and joins the map there. The scans after it, in the
    order of the track, are matched to a map that is partly wrong, and come back to their places only step by step. These
    steps make up for motions that do not count, so that they must not count either, until both directions agree.

    Args:
        motions: as they were measured forward, and as they were measured backward, or None.
        shared: share of the variance of the errors that both directions have in common.

    Returns:
        for each motion whether the forward and the backward direction regain their places over it.
    """
    agree, held_there, held_back = list[bool](), list[bool](), list[bool]()
    for f, b in motions:
        agree.append(b is not None and _agree(f, b, shared))
        held_there.append(not f.on_map)
        held_back.append(b is None or not b.on_map)
    there = _spread(held_there, agree)
    back = _spread(held_back[::-1], agree[::-1])[::-1]
    return list(zip(there, back, strict=True))


def _spread(held: Sequence[bool], agree: Sequence[bool]) -> list[bool]:
    """Returns which motions come, in the order given, after a held one and before one on which both directions agree."""
    spread, after = [], False
    for is_held, both_agree in zip(held, agree, strict=True):
        spread.append(after and not is_held and not both_agree)
        after = is_held or spread[-1]
    return spread


def _agree(forward: Measurement, backward: Measurement, shared: float) -> bool:
    """Returns whether both measurements of one motion are matches, and no farther apart than their covariances explain."""
    return forward.on_map and backward.on_map and not _contradict(forward, backward, shared)


def _contradict(forward: Measurement, backward: Measurement, shared: float) -> bool:
    """Returns whether two measurements of one motion are farther apart than their covariances explain."""
    apart, both = se2.subtract(backward.pose, forward.pose), forward.covariance + backward.covariance
    return bool(apart @ np.linalg.solve((1.0 - shared) * both, apart) > _CHANCE)


def _join_motions(forward: Measurement, backward: Measurement, regains: tuple[bool, bool], shared: float) -> Measurement:
    """Returns what two measurements of one motion say together; one whose scans were both matched counts alone.

    Args:
        forward: the motion as it was measured forward.
        backward: the motion as it was measured backward.
        regains: whether each direction regains its place over this motion, so that the other counts alone if it does not.
        shared: share of the variance of the errors that both have in common.
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
