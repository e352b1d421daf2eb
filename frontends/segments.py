"""Splits a recording into segments: stretches that are tracked on their own, each in one direction of time.

A track goes scan by scan and cannot use more than one processor; segments are tracked in parallel. The track of a segment
first follows some scans of the segment before it (the warm-up), so that the map has grown before the segment's own scans are
matched. Over the last scans of the warm-up, the motions of one track are blended gradually into the motions of the next: a
change at one scan would add the errors of this scan in both maps, whereas a change over many scans adds only the mean of
their errors. The borders of the segments of one direction lie midway between the borders of the other direction, so that
the two directions never begin anew at the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mqslam.config import WARM_UP_SCANS, TrackerConfig
from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.frontends.bidirectional import DirectedMotion, follows_at_once
from mqslam.psi.tracking.plausibility import is_usable

# Number of the last scans of a warm-up over which the motions of one segment's track are blended into those of the next.
_SHARED_SCANS = 16


@dataclass(frozen=True, slots=True)
class Segment:
    """Motions between successive scans, and the scans that are tracked to measure them.

    Args:
        begin, end: number of the first motion, and number of the last motion plus 1; motion k leads from scan k to scan
            k + 1. The motions of successive segments overlap.
        first, last: numbers of the first and the last scan that are tracked, in the order of the recording.
        is_backward: whether these scans are tracked from the last to the first.
    """

    begin: int
    end: int
    first: int
    last: int
    is_backward: bool


def split_into_segments(scans: Sequence[Scan], settings: TrackerConfig) -> list[Segment]:
    """Splits a recording into the segments of both directions, in order of their ends.

    A segment begins where its track can warm up on scans that hold enough returns and follow each other at once. Where
    there are no such scans, as in a long tunnel without returns, the segment before it goes on.

    Args:
        scans: scans of the recording.
        settings: only `segment_scans` is used; if it is 0, each direction is a single segment.
    """
    count, size = max(len(scans) - 1, 0), settings.segment_scans or len(scans)
    warm_up, shared = WARM_UP_SCANS, _SHARED_SCANS
    sound, before = list[bool](), None  # whether each scan can be matched and follows the scan before at once
    for scan in scans:
        sound.append(is_usable(scan) and (before is None or follows_at_once(before, scan)))
        before = scan
    sound_from = [k for k in range(count - warm_up) if all(sound[k : k + warm_up + 1])]
    forward = _choose_borders(count, size, [k + warm_up for k in sound_from], size)
    backward = _choose_borders(count, size + size // 2, sound_from, size)
    segments = [
        *(Segment(max(a - shared, 0), b, max(a - warm_up, 0), b, is_backward=False) for a, b in forward),
        # one more scan before the first, because `turn_back` has no motion for the first scan that is tracked
        *(Segment(a, min(b + shared, count), max(a - 1, 0), min(b + warm_up, count), is_backward=True) for a, b in backward),
    ]
    return sorted(segments, key=lambda s: (s.end, s.is_backward))


def _choose_borders(count: int, first: int, able: Sequence[int], size: int) -> list[tuple[int, int]]:
    """Returns for each segment the number of its first motion, and the number of its last motion plus 1.

    Args:
        count: number of motions.
        first: number of the earliest motion at which the second segment may begin.
        able: numbers of the motions at which segments can begin, in increasing order.
        size: fewest motions of a segment; the last segment has at least half of this number.
    """
    borders = [0]
    for k in able:
        if k >= max(first, borders[-1] + size) and k <= count - size // 2:
            borders.append(k)
    return list(zip(borders, [*borders[1:], count], strict=True))


def extend(track: list[DirectedMotion | None], begin: int, more: Sequence[DirectedMotion | None]) -> None:
    """Extends `track` by the motions of the next track, and blends the two gradually where they overlap.

    Args:
        track: motions since the recording's first scan; None where there is no measurement.
        begin: number of the next track's first motion, which `track` may hold, too.
        more: motions of the next track; None where there is no measurement.
    """
    shared = len(track) - begin
    both = enumerate(zip(track[begin:], more[:shared], strict=True))
    track[begin:] = [*(_blend(a, b, (k + 1.0) / (shared + 1.0)) for k, (a, b) in both), *more[shared:]]


def _blend(earlier: DirectedMotion | None, later: DirectedMotion | None, share: float) -> DirectedMotion | None:
    """Averages two tracks' measurements of a motion; the later track's measurement has the weight `share`.

    If only one of the tracks matched both scans of the motion, its measurement is used alone; if neither did, the earlier
    track's measurement is used alone.
    """
    if earlier is None or later is None:
        return earlier or later
    a, b = earlier.motion, later.motion
    if a.on_map != b.on_map or not a.on_map:
        return later if b.on_map else earlier
    pose = a.pose + share * se2.subtract(b.pose, a.pose)
    covariance = (1.0 - share) * a.covariance + share * b.covariance
    unseen = (1.0 - share) * earlier.unseen + share * later.unseen
    return DirectedMotion(replace(a, pose=pose, covariance=covariance), unseen)
