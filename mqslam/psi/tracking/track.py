"""Tracks a recording by psi: matches every scan, bridges gaps and losses, and measures the scans of young maps again.

A track begins with scans whose motion is found from these scans alone. After a gap or a loss it begins again in the same
way, so that the scans after it never depend on a prediction alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.core.wording import count_of
from mqslam.errors import EstimationError, FewReturnsError
from mqslam.psi.tracking.cold_start import START_SCANS
from mqslam.psi.tracking.plausibility import FEWEST_RETURNS, YOUNG_SCANS, is_usable
from mqslam.psi.tracking.state import limit_step
from mqslam.psi.tracking.tracker import Tracked, Tracker

# Number of lost scans in a row after which the map is given up and a new one is tried.
PATIENCE = 8
# Fewest scans that are measured again. Fewer scans make no better map than the map they were first matched to.
_YOUNG_LEAST = 6


class Track:
    """The track of a recording: its scans are tracked in their order, and held back while they may be measured again.

    Args:
        scans: all scans of the recording.
        tracker: a new tracker.
        find_twist: returns the mean twist (3,) between two times [s] by other sensors, NaN for components that they do not
            measure, and None where they measure nothing. It is used where psi alone does not find or observe the motion.
    """

    def __init__(
        self, scans: Sequence[Scan], tracker: Tracker, find_twist: Callable[[float, float], se2.Array | None]
    ) -> None:
        self._scans = scans
        self._tracker = tracker
        self._find_twist = find_twist
        self._tracked: dict[int, Tracked] = {}  # scans that are not handed on yet
        self._young: list[int] = []  # scans of a track that has only begun
        self._matched = 0  # number of the last scan that was matched
        self._pose = np.zeros(3)  # the pose of that scan
        self._lost: list[int] = []  # scans since the last matched one
        self._patience = PATIENCE  # number of lost scans at which a new map is tried

    def follow(self) -> Iterator[Tracked]:
        """Yields the tracked scans in their order, each as soon as its result cannot change any more.

        Raises:
            EstimationError: there are fewer than two scans.
            FewReturnsError: no two scans in a row hold enough returns.
        """
        first = _find_start(self._scans)
        self._start(first)
        k = first + 1
        handed_on = 0
        while k < len(self._scans):
            k = self._step(k)
            settled = min([k, *self._young[:1], *self._lost[:1]])  # earlier scans cannot change any more
            while handed_on in self._tracked and handed_on < settled:
                yield self._tracked.pop(handed_on)
                handed_on += 1
        self._measure_again()
        for n in range(handed_on, len(self._scans)):
            yield self._tracked.pop(n)

    def _start(self, first: int) -> None:
        """Begins the track with the first scans that hold enough returns, and predicts the poses of all earlier scans."""
        head = _take_head(self._scans, first)
        self._tracked[first] = self._tracker.start(head, odometry=_whole(self._find_twist(head[0].t0, head[-1].t1)))
        self._young, self._matched = [first], first
        for n in range(first):
            scan = self._scans[n]
            self._tracked[n] = self._tracker.look_back(scan, _whole(self._find_twist(scan.t0, head[0].t0)))

    def _step(self, k: int) -> int:
        """Tracks scan k, or begins again after a gap or a loss, and returns the number of the next scan to track."""
        scan = self._scans[k]
        if not self._lost and self._tracker.loses(scan):
            self._measure_again()
            self._resume(k)
            return k + 1
        twist = self._twist_to(scan)
        psi_odometry = self._score_odometry(scan, twist)
        tracked = self._tracker.follow(scan, twist)
        self._tracked[k] = replace(tracked, psi_odometry=psi_odometry)
        if tracked.is_found:
            self._take_as_matched(k)
            return k + 1
        self._measure_again()
        self._lost.append(k)
        return self._begin_again(k) if len(self._lost) == self._patience else k + 1

    def _begin_again(self, k: int) -> int:
        """Begins a new map if the last lost scans alone show a motion; returns the number of the next scan to track."""
        first = self._lost[-START_SCANS]
        before, self._lost = self._lost, []
        if self._resume(first):
            return first + 1
        self._lost, self._patience = before, 2 * self._patience  # every further try would cost as much as this one
        return k + 1

    def _resume(self, k: int) -> bool:
        """Tracks scan k after a gap or a loss, from the motions before and after it; returns whether the track goes on."""
        scan = self._scans[k]
        twist = self._twist_to(scan)
        psi_odometry = self._score_odometry(scan, twist)
        tracked = self._tracker.resume(_take_head(self._scans, k), _whole(twist))
        self._tracked[k] = replace(tracked, psi_odometry=psi_odometry)
        if not tracked.is_found:
            self._lost.append(k)
            return False
        self._take_as_matched(k)
        if tracked.begins_map:
            self._young = [k]
        return True

    def _take_as_matched(self, k: int) -> None:
        self._matched, self._pose = k, self._tracked[k].pose
        self._lost, self._patience = [], PATIENCE
        if self._young:
            self._young.append(k)
            if len(self._young) == YOUNG_SCANS:
                self._measure_again()

    def _measure_again(self) -> None:
        """Measures a second time the scans of a track that has only begun, if there are enough of these scans."""
        young, self._young = self._young, []
        if len(young) >= _YOUNG_LEAST:
            again = self._tracker.remeasure([self._scans[n] for n in young], [self._tracked[n] for n in young])
            self._tracked.update(zip(young, again, strict=True))

    def _score_odometry(self, scan: Scan, twist: se2.Array | None) -> float:
        """Returns psi of a scan where odometry puts it by its mean twist (3,) since the last match; NaN without odometry."""
        twist = _whole(twist)
        now = None if twist is None else _whole(self._find_twist(scan.t0, scan.t1))
        if twist is None or now is None:
            return float("nan")
        pose = se2.compose(self._pose, se2.exp(twist, scan.t0 - self._scans[self._matched].t0))
        return self._tracker.score(scan, pose, now)

    def _twist_to(self, scan: Scan) -> se2.Array | None:
        """Returns the mean twist (3,) from the last matched scan to a scan, as `find_twist` gives it."""
        return self._find_twist(self._scans[self._matched].t0, scan.t0)


def _whole(twist: se2.Array | None) -> se2.Array | None:
    """Returns a twist (3,) if all its components are known, else None."""
    return None if twist is None or np.isnan(twist).any() else twist


def _find_start(scans: Sequence[Scan]) -> int:
    """Returns the number of the first scan that, like the scan after it, holds enough returns.

    Raises:
        EstimationError: there are fewer than two scans.
        FewReturnsError: there are no such scans.
    """
    if len(scans) < 2:
        raise EstimationError(
            f"there is no motion in a recording of {count_of(len(scans), 'scan')}; give at least two scans"
        )
    for k in range(len(scans) - 1):
        if len(_take_head(scans, k)) > 1:
            return k
    most = max(len(scan.returns) for scan in scans)
    raise FewReturnsError(
        f"no two scans in a row hold {FEWEST_RETURNS} returns in more than one direction; "
        f"the most returns in a scan are {most}"
    )


def _take_head(scans: Sequence[Scan], first: int) -> list[Scan]:
    """Returns scans from number `first` on: up to `START_SCANS` with enough returns and no gap, and at least the first."""
    head: list[Scan] = []
    for scan in scans[first : first + START_SCANS]:
        gap = bool(head) and scan.t0 - head[-1].t0 > limit_step(head[-1].t1 - head[-1].t0)
        if gap or not is_usable(scan):
            break
        head.append(scan)
    return head or [scans[first]]
