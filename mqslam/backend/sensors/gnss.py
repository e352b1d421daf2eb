"""Joins GNSS fixes to the pose graph: decides whether they agree with the trajectory, and makes their factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import E, X
from numpy.typing import NDArray

from mqslam.backend.pose_graph import PoseGraph, pose_of, poses_of
from mqslam.backend.sensors.calibration import Use
from mqslam.backend.sensors.gnss_errors import (
    Antenna,
    FixNoise,
    align,
    estimate_antenna,
    find_fix_delay,
    is_mirrored,
    is_too_short,
    measure_fix_noise,
    measure_residual,
    measure_stretch,
)
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import KNOWN_S, Fixes, Georeference, TangentPlane, describe_offset
from mqslam.core.wording import describe_delay, left_or_right
from mqslam.errors import Remedy
from mqslam.factors.gnss_position import REACH, gnss_position, plane_walk

# If fewer fixes than this lie within the recording, they are not used: so few fixes would fit many trajectories.
FEWEST = 10
# Fixes are not used if half of them lie farther from the trajectory than this share of the path's length: no trajectory
# drifts so much.
LARGEST_SHARE = 0.05
# Fixes are not used if the extent of the trajectory is less than this many times the median distance of the fixes from the
# trajectory, since the fixes would then not show the heading of the map.
LEAST_SPREAD = 5.0

_MOST_FIXES: Final = 400  # numerical: largest number of fixes that are tried, enough to show whether they fit
_BETTER: Final = 0.5  # a mistake is named if its correction reduces the residuals to at most this share
SWAPPED: Final = "they fit if their latitudes and longitudes are swapped: swap the two"


def find_mistake(fixes: Fixes, times: NDArray[np.float64], starts: NDArray[np.float64], chain: se2.Array) -> str:
    """Names the usual mistake, such as swapped coordinates, that explains why fixes do not fit; "" if none explains it.

    On a drive that is too short to show a delay of the stamps, no delay is named: fixes of many other times would fit, too.

    Args:
        fixes: one or more fixes of the receiver.
        times: (F,) times of the fixes [s] since the recording's start, increasing.
        starts: (N,) start times of the scans [s] since the recording's start, increasing.
        chain: (N, 3) poses of the scans in the map's frame [m, m, rad].
    """
    path_m = float(se2.step_lengths(chain).sum())

    def misfit(times: NDArray[np.float64], positions: NDArray[np.float64], *, must_fit: bool = True) -> float:
        """Returns the median distance [m] of fixes from the trajectory; inf if they do not fit it and `must_fit` is set."""
        inside = np.flatnonzero((starts[0] <= times) & (times <= starts[-1]))
        if len(inside) < FEWEST:
            return np.inf
        inside = inside[:: 1 + len(inside) // _MOST_FIXES]
        points = se2.interpolate(starts, chain, times[inside])[:, :2]
        usual_m = measure_residual(points, positions[inside])
        spread_m = float(np.hypot(*np.ptp(points, axis=0)))
        fits = usual_m <= LARGEST_SHARE * path_m and spread_m >= LEAST_SPREAD * usual_m
        return usual_m if fits or not must_fit else np.inf

    plane = TangentPlane.at_middle(fixes)
    positions = plane.project(fixes.latitudes, fixes.longitudes)
    otherwise = [misfit(times, positions * [1.0, side], must_fit=False) for side in (1.0, -1.0)]  # and mirrored
    found = []
    for late_s in () if is_too_short(starts) else KNOWN_S:
        mistake = f"their stamps seem to be {describe_offset(late_s)}: add {-late_s:.0f} s to them"
        found.append((misfit(times - late_s, positions), mistake))
    if np.abs(fixes.longitudes).max() <= 90.0:
        swapped = TangentPlane(plane.longitude, plane.latitude).project(fixes.longitudes, fixes.latitudes)
        found.append((misfit(times, swapped), SWAPPED))
    least, mistake = min(found, default=(np.inf, ""))
    return mistake if least < _BETTER * min(otherwise) else ""


# Largest share of fixes that may be jumps. With more jumps the fixes are not used: even mirrored fixes, or fixes of another
# drive, agree with a part of the trajectory by chance.
_MOST_JUMPS = 0.25
# Number of successive fixes for which the graph has one common value of the receiver's slowly changing error, so that a jump
# among them has little influence. The values are at least one scan apart. Over longer times the error is not constant, and
# the trajectory would depend on where the values happen to lie: the RMS error of a real drive was 0.50 m with a value every
# 5.4 s, and 1.02 m with a value every 5.5 s.
_FIXES_OF_KNOT = 5
# Fixes whose error changes by more than this [m] in a second are not used: the error of no receiver changes so fast.
_LARGEST_WALK_M = 3.0
# If the position of the antenna is not stated, it is estimated from the fixes. The estimate is used if it is farther away
# from the radar than this many standard deviations. Otherwise the antenna is taken to be at the radar.
_ANTENNA_APART = 3.0

MIRRORED: Final = "the radar is mirrored: set sensor.clockwise: false if it is mounted upside down"
_ROUNDS: Final = 3  # rounds of antenna and noise; they settle in fewer
_LEAST_WALK_M: Final = 1e-4  # numerical: least standard deviation between two poses of the plane, even if it does not drift


@dataclass(frozen=True, slots=True)
class FixEdges:
    """GNSS fixes as edges of the pose graph: positions of scans in the tangent plane.

    The pose of the tangent plane in the map is a variable that changes slowly, like the receiver's error.

    Args:
        scans: (F,) number of the scan whose pose each fix measures.
        poses: (F, 3) poses of these scans in the tangent plane: positions by the fixes, yaws by the trajectory [m, m, rad].
        knots: (F,) index of the pose of the tangent plane that applies to each fix.
        noise: noise of the fixes.
        walks_m: (K - 1,) standard deviation of the change from each pose of the plane to the next [m].
        plane: the tangent plane.
        origin: (3,) approximate pose of the tangent plane in the map [m, m, rad].
    """

    scans: NDArray[np.int64]
    poses: se2.Array
    knots: NDArray[np.int64]
    noise: FixNoise
    walks_m: NDArray[np.float64]
    plane: TangentPlane
    origin: se2.Array

    def add_to(self, graph: PoseGraph, chain: se2.Array) -> None:
        """Adds the tangent plane's poses e0, e1, ... to the graph, with factors to scans and between successive poses.

        `chain` is not used: all poses of the plane start at `origin`.
        """
        for j, k, pose in zip(self.knots.tolist(), self.scans.tolist(), self.poses, strict=True):
            graph.factors.push_back(gnss_position(E(j), X(k), pose, self.noise.white_m))
        for j, walk_m in enumerate(self.walks_m.tolist()):
            graph.factors.push_back(plane_walk(E(j), E(j + 1), walk_m))
        for j in range(len(self.walks_m) + 1):
            graph.initial.insert(E(j), gtsam.Pose2(*self.origin))

    def find_place(self, values: gtsam.Values) -> Georeference:
        """Returns the pose of a map on the Earth, by the mean of the tangent plane's poses in the optimised `values`."""
        poses = poses_of(values, len(self.walks_m) + 1, E)
        return Georeference(self.plane, se2.inverse(poses.mean(axis=0)))

    def count_rejected(self, values: gtsam.Values) -> int:
        """Returns the number of jumps: fixes farther than REACH standard deviations from the trajectory in `values`."""
        origins, placed = (
            np.array([pose_of(values, key(int(k))) for k in numbers]) for key, numbers in ((E, self.knots), (X, self.scans))
        )
        off = np.hypot(*(se2.between(origins, placed)[:, :2] - self.poses[:, :2]).T)
        return int(np.count_nonzero(off > REACH * self.noise.white_m))


@dataclass(frozen=True, slots=True)
class FixUse(Use[FixEdges]):
    """The result of the comparison of GNSS fixes with the front end's motions.

    The first statement says whether the fixes are used, but only after `refuse` or `judge_jumps` has added it.

    Args:
        antenna: position of the antenna as the fixes show it; None if the position is stated, or if the fixes are not used.
        stretch: ratio of the fixes' distances to the trajectory's distances; None if another scale does not fit far better.
        is_mirrored: whether the fixes fit the mirror image of the trajectory far better than the trajectory.
        mistake: a sentence on the usual mistake that explains why the fixes do not fit; "" if there is none.
    """

    antenna: Antenna | None = None
    stretch: float | None = None
    is_mirrored: bool = False
    mistake: str = ""

    def refuse(self, why: str) -> FixUse:
        """Returns a copy in which the fixes are not used, with a statement of the reason `why` and of the likely mistake."""
        hint = ""
        if self.stretch is not None:
            hint = (
                f"; their distances are {self.stretch:.3g} times as long as in the trajectory, so the "
                f"length of a range bin may be wrong, not the fixes: {Remedy.GIVE_RANGE_RESOLUTION}"
            )
        if self.is_mirrored:
            swapped = "as if latitude and longitude were swapped"
            hint = f"; they fit the mirror image of the trajectory: they are mirrored, {swapped}, or {MIRRORED}"
        if self.mistake:
            hint = f"; {self.mistake}"
        statement = f"the GNSS fixes ({self.source}) are not used: {why}{hint}"
        return replace(self, statements=(statement,), edges=None, antenna=None)

    def judge_jumps(self, values: gtsam.Values) -> FixUse:
        """Counts the jumps, given the optimum of the graph with the fixes; refuses the fixes if too many of them are jumps.

        Otherwise a statement with the number of fixes and jumps is added.
        """
        if self.edges is None:
            return self
        number, jumps = len(self.edges.scans), self.edges.count_rejected(values)
        if jumps > _MOST_JUMPS * number:
            why = f"{jumps} of {number} contradict the radar's motion, wherever the map is placed on the Earth"
            return self.refuse(why)
        said = f"the GNSS fixes ({self.source}) are used, {number} of them"
        rejected = "1 is a jump and hardly counts" if jumps == 1 else f"{jumps} are jumps and hardly count"
        counted = f"{said}, of which {rejected}" if jumps else said
        return replace(self, statements=(counted, *self.statements))


def join_fixes(fixes: Fixes, start_us: int, motions: Sequence[Measurement], antenna: NDArray[np.float64] | None) -> FixUse:
    """Compares fixes with the chained motions, and converts the fixes to positions of scans if they agree.

    Jumps are judged afterwards by `FixUse.judge_jumps`, in the graph with the fixes. If the position of the antenna is
    neither stated nor shown by the fixes, the antenna is taken to be at the radar.

    Args:
        fixes: fixes of the receiver.
        start_us: stamp [us] of the recording's time zero.
        motions: motions between successive scans, as the front end measured them.
        antenna: (2,) stated position of the antenna in the radar's frame [m], or None.
    """
    use = FixUse(fixes.source, ())
    if not len(fixes):
        return use.refuse("there are no fixes")
    chain, starts = se2.chain(m.pose for m in motions), np.array([*(m.t0 for m in motions), motions[-1].t1])
    times: NDArray[np.float64] = np.asarray((fixes.stamps_us - start_us) * 1e-6)
    plane = TangentPlane.at_middle(fixes)
    positions = plane.project(fixes.latitudes, fixes.longitudes)
    use = replace(use, mistake=find_mistake(fixes, times, starts, chain))
    there = (starts[0] <= times) & (times <= starts[-1])
    if not use.mistake and np.count_nonzero(there) >= FEWEST:
        own = se2.interpolate(starts, chain, times[there])[:, :2]
        use = replace(use, is_mirrored=is_mirrored(own, positions[there]))
    delay_s = find_fix_delay(times, positions, starts, chain)
    if fixes.own_clock and not delay_s:
        drive = "the drive is too short to show" if is_too_short(starts) else "the drive does not show"
        return use.refuse(f"they have another clock than the radar, and {drive} the offset of the clocks")
    times = times - delay_s
    inside = (starts[0] <= times) & (times <= starts[-1])
    if np.count_nonzero(inside) < FEWEST:
        return use.refuse(f"{np.count_nonzero(inside)} of them lie within the recording, and {FEWEST} are needed")
    times, positions = times[inside], positions[inside]
    sensor = se2.interpolate(starts, chain, times)
    on_map, lies, residuals = _lay(sensor, np.zeros(2) if antenna is None else antenna, positions)
    use = replace(use, stretch=measure_stretch(on_map, positions))
    usual_m, path_m = float(np.median(np.hypot(*residuals.T))), float(se2.step_lengths(chain).sum())
    spread_m = float(np.hypot(*np.ptp(on_map, axis=0)))
    if usual_m > LARGEST_SHARE * path_m or spread_m < LEAST_SPREAD * usual_m:
        return use.refuse(
            f"half of them lie more than {usual_m:.1f} m from the trajectory, whose path is {path_m:.0f} m long and "
            f"spreads over {spread_m:.0f} m"
        )
    noise = measure_fix_noise(times, residuals, fixes.sigmas_m[inside])
    found: Antenna | None = None
    if antenna is None:
        for _ in range(_ROUNDS):  # at first, the swings of an antenna that is not at the radar look like noise
            found = estimate_antenna(times, se2.compose(lies, sensor), positions, noise)
            if found.significance > _ANTENNA_APART:
                on_map, lies, residuals = _lay(sensor, found.place, positions)
                noise = measure_fix_noise(times, residuals, fixes.sigmas_m[inside])
    if noise.walk_m > _LARGEST_WALK_M:
        return use.refuse(
            f"they wander about the trajectory by {noise.walk_m:.1f} m in a second: they belong to another drive, or "
            "their clock is not the recording's clock"
        )
    knot_s = max(_FIXES_OF_KNOT * float(np.median(np.diff(times))), float(np.median(np.diff(starts))))
    knots = np.unique(np.floor(times / knot_s), return_inverse=True)[1]  # there is no knot for times without a fix
    middles = np.bincount(knots, times) / np.bincount(knots)
    walks_m = np.maximum(noise.walk_m * np.sqrt(np.diff(middles)), _LEAST_WALK_M)
    scans = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(starts) - 1)
    from_scan = _turn(-chain[scans, :2] + on_map, lies[2])
    poses = np.column_stack([positions - from_scan, se2.wrap(chain[scans, 2] + lies[2])])
    edges = FixEdges(scans, poses, knots, noise, walks_m, plane, se2.inverse(lies))
    corrections = []
    if delay_s:
        corrections.append(f"the clock of the GNSS fixes is {describe_delay(delay_s)}, which is put right")
    if found is not None and found.significance > _ANTENNA_APART:
        x, y = found.place
        corrections.append(
            f"the GNSS fixes show that the antenna sits {abs(x):.2f} m {'ahead of' if x >= 0.0 else 'behind'} the radar and "
            f"{abs(y):.2f} m to its {left_or_right(y)} (± {found.sigmas[0]:.2g} m and ± {found.sigmas[1]:.2g} m)"
        )
    return replace(use, statements=tuple(corrections), edges=edges, antenna=found)


def _lay(
    sensor: se2.Array, antenna: NDArray[np.float64], positions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], se2.Array, NDArray[np.float64]]:
    """Aligns the trajectory with the fixes.

    Args:
        sensor: (F, 3) poses of the radar at the times of the fixes, in the map's frame [m, m, rad].
        antenna: (2,) position of the antenna in the radar's frame [m].
        positions: (F, 2) fixes in the tangent plane [m].

    Returns:
        The positions (F, 2) of the antenna in the map [m]; the pose (3,) of the map in the tangent plane [m, m, rad]; and
        the residuals (F, 2) of the fixes in the tangent plane [m].
    """
    on_map = sensor[:, :2] + _turn(antenna, sensor[:, 2])
    lies = align(on_map, positions)
    return on_map, lies, positions - se2.transform(lies, on_map)


def _turn(points: NDArray[np.float64], yaws: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Rotates points (N, 2) by one yaw [rad], or one point (2,) by each of yaws (N,); returns points (N, 2)."""
    c, s, x, y = np.cos(yaws), np.sin(yaws), points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
