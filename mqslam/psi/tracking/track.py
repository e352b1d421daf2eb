"""Tracks a recording by psi: matches every scan, bridges gaps and losses, and measures the scans of young maps again.

A scan is matched if its pose in the map was found, else it is lost. A track begins with a few scans (at most `START_SCANS`)
whose motion is found from these scans alone. After a gap or after lost scans, the motion is found in the same way again, so
that later scans never depend on a prediction alone.
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

# Number of lost scans in a row after which the tracker tries to begin a new map.
PATIENCE = 8
# Fewest scans that are measured a second time. Fewer scans make no better map than the map of their first measurement.
_YOUNG_LEAST = 6


class Track:
    """The track of a recording: tracks the scans in their order, and holds results back while they may still change.

    Args:
        scans: all scans of the recording.
        tracker: a new tracker.
        find_twist: returns the mean twist (3,) vx, vy [m/s], omega [rad/s] between two times [s] by other sensors, here
            called odometry; NaN for components that no sensor measures, and None if no component is measured. The twist is
            used where psi alone does not find or observe the motion.
    """

    def __init__(
        self, scans: Sequence[Scan], tracker: Tracker, find_twist: Callable[[float, float], se2.Array | None]
    ) -> None:
        self._scans = scans
        self._tracker = tracker
        self._find_twist = find_twist
        self._tracked: dict[int, Tracked] = {}  # results that `follow` has not yielded yet, by number of the scan
        self._young: list[int] = []  # numbers of the scans of a map that has only begun, for a second measurement
        self._matched = 0  # number of the last scan that was matched
        self._pose = np.zeros(3)  # the pose of that scan
        self._lost: list[int] = []  # numbers of the lost scans since then
        self._patience = PATIENCE  # number of lost scans at which a new map is tried

    def follow(self) -> Iterator[Tracked]:
        """Yields the results of all scans in their order, each result as soon as it cannot change any more.

        Raises:
            EstimationError: there are fewer than two scans.
            FewReturnsError: no two scans in a row hold enough returns; scans with a gap between them count only if odometry
                bridges the gap.
        """
        first = _find_start(self._scans, self._tracker)
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
        """Begins the track at scan number `first`, and predicts the poses of all earlier scans, which show no motion."""
        head = _take_head(self._scans, first, 2 if self._tracker.is_guided else 1)
        self._tracked[first] = self._tracker.start(head, odometry=_whole(self._find_twist(head[0].t0, head[-1].t1)))
        self._young, self._matched = [first], first
        for n in range(first):
            scan = self._scans[n]
            self._tracked[n] = self._tracker.look_back(scan, _whole(self._find_twist(scan.t0, head[0].t0)))

    def _step(self, k: int) -> int:
        """Tracks scan k; returns the next scan's number, which is not k + 1 if `_begin_again` goes on from a lost scan."""
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
        """Tries to go on from a lost scan shortly before scan k; returns the number of the next scan to track.

        That is the scan after this lost scan if the track goes on from there, else scan k + 1.
        """
        first = self._lost[-START_SCANS]
        before, self._lost = self._lost, []
        if self._resume(first):
            return first + 1
        self._lost, self._patience = before, 2 * self._patience  # every further try would cost as much as this one
        return k + 1

    def _resume(self, k: int) -> bool:
        """Tracks scan k after a gap or lost scans, by the motions before and after; returns whether the track goes on."""
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
        """Measures the scans of a young map for the second time, if there are enough of these scans."""
        young, self._young = self._young, []
        if len(young) >= _YOUNG_LEAST:
            again = self._tracker.remeasure([self._scans[n] for n in young], [self._tracked[n] for n in young])
            self._tracked.update(zip(young, again, strict=True))

    def _score_odometry(self, scan: Scan, twist: se2.Array | None) -> float:
        """Returns psi of a scan at the pose and the motion that odometry gives; NaN if odometry lacks any component.

        `twist` (3,) is odometry's mean twist [m/s, m/s, rad/s] from the last matched scan to this scan.
        """
        twist = _whole(twist)
        now = None if twist is None else _whole(self._find_twist(scan.t0, scan.t1))
        if twist is None or now is None:
            return float("nan")
        pose = se2.compose(self._pose, se2.exp(twist, scan.t0 - self._scans[self._matched].t0))
        return self._tracker.score(scan, pose, now)

    def _twist_to(self, scan: Scan) -> se2.Array | None:
        """Returns the result of `find_twist` from the last matched scan to a scan."""
        return self._find_twist(self._scans[self._matched].t0, scan.t0)


def _whole(twist: se2.Array | None) -> se2.Array | None:
    """Returns a twist (3,) if no component is NaN, else None."""
    return None if twist is None or np.isnan(twist).any() else twist


def _find_start(scans: Sequence[Scan], tracker: Tracker) -> int:
    """Returns the number of the first of two successive scans that hold enough returns and have no gap between them.

    A guided tracker, whose odometry bridges gaps, takes the first two scans that hold enough returns if none of the first
    `START_SCANS` scans begins such a pair: a robot that drives slowly has a gap between most of its scans.

    Raises:
        EstimationError: there are fewer than two scans.
        FewReturnsError: there are no such scans.
    """
    if len(scans) < 2:
        raise EstimationError(
            f"there is no motion in a recording of {count_of(len(scans), 'scan')}; give at least two scans"
        )

    def find_pair(begins: range, least: int = 1) -> int | None:
        return next((k for k in begins if len(_take_head(scans, k, least)) > 1), None)

    begins = range(len(scans) - 1)
    first = find_pair(begins[:START_SCANS] if tracker.is_guided else begins)
    if first is None and tracker.is_guided:
        first = find_pair(begins, 2)
    if first is not None:
        return first
    most = max(len(scan.returns) for scan in scans)
    apart = "" if tracker.is_guided else " without a gap between the scans"
    raise FewReturnsError(
        f"no two scans in a row hold {FEWEST_RETURNS} returns in more than one direction{apart}; "
        f"the scan with the most returns holds {most}"
    )


def _take_head(scans: Sequence[Scan], first: int, least: int = 1) -> list[Scan]:
    """Returns up to `START_SCANS` successive scans from number `first` on, up to a gap or a scan with too few returns.

    The first scan is always returned, whatever it holds. The first `least` scans may have gaps between them.
    """
    head: list[Scan] = []
    for scan in scans[first : first + START_SCANS]:
        gap = len(head) >= least and scan.t0 - head[-1].t0 > limit_step(head[-1].t1 - head[-1].t0)
        if gap or not is_usable(scan):
            break
        head.append(scan)
    return head or [scans[first]]
