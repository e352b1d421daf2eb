"""The first scans of a track, measured again once there is a map which does not rest on them alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum
from mqslam.psi.tracking.dynamics import predict
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.state import POSE, SIZE, State
from mqslam.psi.tracking.tracked import Tracked
from mqslam.psi.tracking.uncertainty import measure_covariance, update_belief


def remeasure(
    scans: Sequence[Scan], tracked: Sequence[Tracked], matcher: Matcher, is_out_of_place: Callable[[Minimum], bool]
) -> list[Tracked]:
    """Measures the first scans of a track again.

    The first scans were matched to a map of a few scans whose own motion was hardly known. The later half of the scans is
    taken as it is; the earlier half is matched to it backward in time, the latest first. A scan that is not found so keeps
    its first measurement, and those before it move along with it.

    Args:
        scans: those of the track so far.
        tracked: what the tracker returned for them.
        matcher: matches scans to a map.
        is_out_of_place: whether a match is probably none.
    """
    setup = matcher.setup
    half = len(scans) // 2
    around = LocalMap(setup.tuning)
    for scan, t in zip(scans[half:], tracked[half:], strict=True):
        around.add(t.t0, t.pose, matcher.place(scan, t.state))
    results = list(tracked)
    after = update_belief(tracked[half].state.vector, tracked[half].evaluation, np.zeros((SIZE, SIZE)), setup)
    for k in range(half - 1, -1, -1):
        predicted = predict(after, scans[k].t0 - scans[k + 1].t0, setup.settings)
        minimum = matcher.minimise(scans[k], predicted.mean, predicted.prior, around)
        state = State(minimum.state)
        if is_out_of_place(minimum) or len(matcher.find_weak_directions(scans[k], state, around)):
            results[: k + 1] = _move_along(tracked[: k + 1], tracked[k + 1], results[k + 1])
            break
        placed = matcher.place(scans[k], state)
        results[k] = replace(
            tracked[k],
            state=state,
            covariance=measure_covariance(minimum.evaluation, placed, predicted, around, setup)[POSE, POSE],
            unseen=np.zeros((3, 3)),
            evaluation=minimum.evaluation,
            earlier=tracked[k].pose,
        )
        around.add(tracked[k].t0, state.pose, placed)
        after = update_belief(minimum.state, minimum.evaluation, predicted.information, setup)
    return results


def map_tracked(scans: Sequence[Scan], tracked: Sequence[Tracked], matcher: Matcher) -> LocalMap:
    """Makes the map of scans where they were tracked."""
    result = LocalMap(matcher.setup.tuning)
    for scan, t in zip(scans, tracked, strict=True):
        result.offer(t.t0, t.pose, matcher.place(scan, t.state))
    return result


def _move_along(others: Sequence[Tracked], before: Tracked, after: Tracked) -> list[Tracked]:
    """Moves scans so that they keep their places about a scan that was moved from one place to another."""
    moved = []
    for other in others:
        pose = se2.compose(after.pose, se2.between(before.pose, other.pose))
        moved.append(replace(other, state=State.of(pose, other.state.motion), earlier=other.pose))
    return moved
