"""A drive through a city: a route of rounds in the right-hand lane, slower in corners, with stops at some crossings.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mqslam.simulator.city.plan import CityPlan, Street, lay_plan, offset_line
from mqslam.simulator.drive import SampledDrive, limit_acceleration
from mqslam.simulator.scene import Array

SPACING = 0.25
"""Distance between the samples of a path [m]."""
CORNER = 8.0
"""Distance before a crossing's outermost lane at which a corner begins [m]."""
BEND = 8.0
"""Distance before a bend within a street at which the path begins to turn [m]."""
ROUNDING = 0.47
"""Length of the handles of a corner's Bezier curve, as a share of the distance between the corner's ends.

The handles of an arc would be slightly shorter."""
PATH_SMOOTHING, TIME_SMOOTHING = 2.5, 0.5
"""Standard deviations of the filters that smooth the path [m] and the progress along the path [s]."""
WANDER, WANDER_LENGTH = 0.12, 25.0
"""Standard deviation of the sideways position in the lane [m], and the distance over which this position changes [m]."""
AHEAD, SIDEWAYS = 1.4, 1.8
"""Largest accelerations along and across the path [m/s^2]."""
STOP_CHANCE = 0.25
"""Probability of a stop before a crossing."""
STOP_S = (2.0, 6.0)
"""Shortest and longest stop [s]."""

UNDER_WAY_S = 10.0
"""Time that the vehicle has already spent on its route at the drive's time zero [s]."""


def make_city_drive(seed: int, duration_s: float) -> SampledDrive:
    """Makes a drive that lasts `duration_s` [s] through the city of the same seed."""
    plan = lay_plan(seed)
    fastest = max(street.profile.speed for street in plan.driven_streets())
    points, speeds, crossings = _lay_path(plan, plan_route(seed, plan, fastest * (duration_s + 2.0 * UNDER_WAY_S)))
    rng = np.random.default_rng([seed, 9])
    points = _wander(rng, gaussian_filter1d(points, PATH_SMOOTHING / SPACING, axis=0, mode="nearest"))
    reach = round(4.0 * PATH_SMOOTHING / SPACING)  # the ends are cut off, since their smoothing lacks the points beyond them
    points, speeds = points[reach:-reach], speeds[reach:-reach]
    places = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    along = np.arange(0.0, places[-1], SPACING)
    speeds = np.interp(along, places, speeds)
    line = CubicSpline(places, points)
    speeds = np.minimum(speeds, np.sqrt(SIDEWAYS / np.maximum(np.abs(_curvatures(line, along)), 1e-6)))
    stops = [k - reach for k in crossings if rng.random() < STOP_CHANCE and reach < k - reach < len(places)]
    stops = np.searchsorted(along, places[stops]) - 1
    speeds[stops] = 0.0
    speeds = limit_acceleration(along, speeds, AHEAD)
    waits = np.zeros(len(along))
    waits[stops] = rng.uniform(*STOP_S, len(stops))
    return _drive_along(line, *_time_progress(along, speeds, waits), duration_s)


def _lay_path(plan: CityPlan, route: list[Course]) -> tuple[Array, Array, list[int]]:
    """Makes the path along the lanes of a route, with rounded corners and bends.

    Returns:
        Points (N, 2) [m], about `SPACING` apart; the usual speed at each point (N,) [m/s]; the index of the last point
        before each crossing.
    """
    corners = np.zeros(len(plan.crossings))
    for street in plan.driven_streets():
        for end in street.ends:
            corners[end] = max(corners[end], street.profile.lanes[-1] + CORNER)
    points: list[Array] = []
    speeds: list[Array] = []
    crossings: list[int] = []
    number = 0
    for course in route:
        profile = course.street.profile
        steps = np.diff(course.line, axis=0)
        lane = offset_line(course.line, np.full(len(steps), -profile.lanes[-1]), closed=False)
        for piece, step in enumerate(steps):
            length = float(np.hypot(*step))
            first = corners[course.start] if piece == 0 else BEND
            last = corners[course.end] if piece == len(steps) - 1 else BEND
            ends = lane[piece] + np.array([[first], [max(length - last, first + 1.0)]]) / length * step
            if points:
                points.append(_round_corner(points[-1][-2:], ends))
                speeds.append(np.full(len(points[-1]), profile.speed))
                number += len(points[-1])
            share = np.linspace(0.0, 1.0, max(2, round(float(np.hypot(*(ends[1] - ends[0]))) / SPACING)))[:, None]
            points.append(ends[0] + share * (ends[1] - ends[0]))
            speeds.append(np.full(len(share), profile.speed))
            number += len(share)
        crossings.append(number - 1)
    return np.concatenate(points), np.concatenate(speeds), crossings


def _round_corner(before: Array, after: Array) -> Array:
    """Returns points (N, 2) [m] of a rounded corner between two straight pieces.

    Args:
        before: (2, 2) start and end of the piece before the corner [m].
        after: (2, 2) start and end of the piece after the corner [m].
    """
    a, b = before[1], after[0]
    distance = float(np.hypot(*(b - a)))
    u, v = before[1] - before[0], after[1] - after[0]
    p = a + ROUNDING * distance * u / np.hypot(*u)
    q = b - ROUNDING * distance * v / np.hypot(*v)
    t = np.linspace(0.0, 1.0, max(3, round(1.1 * distance / SPACING)))[1:-1, None]
    return np.asarray((1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * p + 3 * t**2 * (1 - t) * q + t**3 * b)


def _wander(rng: np.random.Generator, points: Array) -> Array:
    """Returns points (N, 2) [m] of a path, moved a little sideways, since nobody drives exactly on a lane's centre line."""
    sigma = WANDER_LENGTH / SPACING
    aside = gaussian_filter1d(rng.standard_normal(len(points)), sigma) * np.sqrt(2.0 * np.sqrt(np.pi) * sigma) * WANDER
    along = np.gradient(points, axis=0)
    along /= np.hypot(*along.T)[:, None]
    return np.asarray(points + aside[:, None] * np.c_[-along[:, 1], along[:, 0]])


def _curvatures(line: CubicSpline, along: Array) -> Array:
    """Returns the curvatures (N,) [1/m] of a line, whose parameter is the distance [m], at distances `along` (N,) [m]."""
    (dx, dy), (ex, ey) = line(along, 1).T, line(along, 2).T
    return np.asarray((dx * ey - dy * ex) / np.hypot(dx, dy) ** 3)


def _time_progress(along: Array, speeds: Array, waits: Array) -> tuple[Array, Array]:
    """Returns times (2N,) [s] of arriving at and leaving each of the distances `along` (N,) [m], and these distances (2N,).

    Speeds (N,) [m/s] and waits (N,) [s] are given at these distances; the acceleration is constant in between.
    """
    steps = 2.0 * np.diff(along) / (speeds[1:] + speeds[:-1])
    arrived = np.r_[0.0, np.cumsum(steps + waits[:-1])]
    leaving = arrived + waits
    return np.c_[arrived, leaving].ravel(), np.repeat(along, 2)


def _drive_along(line: CubicSpline, times: Array, reached: Array, duration_s: float) -> SampledDrive:
    """Makes a drive of `duration_s` [s] along a line that reaches the distances `reached` (M,) [m] at the times (M,) [s].

    The parameter of the line is the distance along it [m]. The drive's time zero is `UNDER_WAY_S` after zero of these times.
    """
    ticks = np.asarray(np.arange(-200, round(duration_s / 0.02) + 250) * 0.02, dtype=np.float64)
    progress = gaussian_filter1d(np.interp(ticks + UNDER_WAY_S, times, reached), TIME_SMOOTHING / 0.02)
    kept = (ticks >= -1.0) & (ticks <= duration_s + 1.0)
    ticks, progress, pace = ticks[kept], progress[kept], np.gradient(progress, 0.02)[kept]
    points, slopes = line(progress), line(progress, 1)
    yaw = np.unwrap(np.arctan2(slopes[:, 1], slopes[:, 0]))
    turning = _curvatures(line, progress) * np.hypot(*slopes.T)
    return SampledDrive(ticks, np.c_[points, yaw], np.c_[slopes, turning] * pace[:, None])


OUTWARD = 300.0
"""Length [m] of the way out of a round, after which the round leads back."""
LONGEST = 1300.0
"""Length [m] of the longest round; a round that would be longer turns back earlier."""
AGAIN = 2.0
"""Factor on the length of a street that was driven before, so that rounds prefer new streets."""
LONGEST_BACK = 1100.0
"""Largest length [m] of a round that is driven backwards, including the way on which the vehicle turns round."""


class Course(NamedTuple):
    """A street driven in one direction: way 1 leads from the street's first end to its second end, way -1 back."""

    street: Street
    way: int

    @property
    def start(self) -> int:
        """Index in `CityPlan.crossings` of the crossing at which the course begins."""
        return self.street.ends[:: self.way][0]

    @property
    def end(self) -> int:
        """Index in `CityPlan.crossings` of the crossing at which the course ends."""
        return self.street.ends[:: self.way][1]

    @property
    def line(self) -> Array:
        """Centre line (K, 2) [m] of the street, in the direction of the course."""
        return self.street.line[:: self.way]


def plan_route(seed: int, plan: CityPlan, length: float) -> list[Course]:
    """Plans a route of rounds through several blocks each, without turning round in a street.

    A round leads to streets that were not driven before, and back, by other streets if the way is not much longer. Each
    round is driven twice. A short round is driven backwards the second time, unless the round before it was. Then the route
    goes on to the start of the next round.

    Args:
        seed: seed of the route.
        plan: the city.
        length: least length of the route [m].
    """
    rng = np.random.default_rng([seed, 8])
    courses = [Course(street, way) for street in plan.driven_streets() for way in (1, -1)]  # k ^ 1: the way back of k
    net = _Net(courses)
    park = {street.ends for block in plan.blocks if block.kind == "park" for street in block.fronts}
    wide = [k for k, course in enumerate(courses) if course.street.kind == "carriageway"]
    sights = [k for k, c in enumerate(courses) if c.street.kind in ("bridge", "carriageway") or c.street.ends in park]
    route = [int(rng.choice(wide))]
    backwards = False
    while sum(courses[k].street.length for k in route) < length:
        driven = net.are_driven(route)
        new = [k for k in sights if not driven[k]] or np.flatnonzero(~driven).tolist() or list(range(len(courses)))
        tour = _make_round(net, route[-1], new, driven)
        route += tour
        back = _turn_round(net, route[-1], tour)
        backwards = not backwards and net.lengths[back].sum() < LONGEST_BACK
        route += back if backwards else tour
        driven = net.are_driven(route)
        onward = [k for k in new if not driven[k]] or [int(rng.integers(len(courses)))]
        route += net.find_way(route[-1], onward, np.ones(len(courses)))
    return [courses[k] for k in route]


def _make_round(net: _Net, base: int, goals: list[int], driven: NDArray[np.bool_]) -> list[int]:
    """Returns the indices of the courses of a round that begins after the course `base` and ends with this course.

    Args:
        net: the courses of the city.
        base: index of the course after which the round begins.
        goals: indices of courses that the round should visit, the nearest one first.
        driven: (C,) whether each course lies in a street that was driven before.
    """
    way = [base]
    gone = 0.0
    while goals and gone < OUTWARD:
        leg = net.find_way(way[-1], goals, np.where(driven, AGAIN, 1.0))
        for course in leg:
            if gone < OUTWARD:
                way.append(course)
                gone += net.lengths[course]
        driven = driven | net.are_driven(way)
        goals = [k for k in goals if not driven[k]]
    factors = np.where(driven, AGAIN, 1.0)
    tour = way[1:] + net.find_way(way[-1], [base], factors)
    while len(way) > 2 and net.lengths[tour].sum() > LONGEST:
        way.pop()
        tour = way[1:] + net.find_way(way[-1], [base], factors)
    return tour


def _turn_round(net: _Net, here: int, tour: list[int]) -> list[int]:
    """Returns the way from the course `here` to the nearest street of a round, then the whole round backwards.

    Ways and rounds are lists of the indices of courses.
    """
    tour = [k ^ 1 for k in tour[::-1]]
    way = net.find_way(here, tour, np.ones(len(net.lengths)))
    begin = tour.index(way[-1])
    return way[:-1] + tour[begin:] + tour[:begin]


class _Net:
    """The network of all courses with their lengths (C,) [m], in which shortest ways are found.

    A course can be followed by any course that begins at its end, except by its own way back.
    """

    def __init__(self, courses: list[Course]) -> None:
        self.lengths = np.array([course.street.length for course in courses])
        leaving: dict[int, list[int]] = {}
        for k, course in enumerate(courses):
            leaving.setdefault(course.start, []).append(k)
        self._before, self._after = np.array(
            [(k, m) for k, course in enumerate(courses) for m in leaving[course.end] if m != k ^ 1]
        ).T

    def are_driven(self, route: list[int]) -> NDArray[np.bool_]:
        """Returns for each course (C,) whether it lies in a street that a route uses, in either direction."""
        return np.isin(np.arange(len(self.lengths)) // 2, np.array(route) // 2)

    def find_way(self, here: int, goals: list[int], factors: NDArray[np.float64]) -> list[int]:
        """Returns the shortest way from the course `here` to the nearest of the courses `goals`; empty if there is no way.

        The way consists of indices of courses, without `here`. To prefer some streets, the lengths of the courses are
        multiplied by `factors` (C,).
        """
        costs = (self.lengths * factors)[self._after]
        size = len(self.lengths)
        costs, before = dijkstra(
            csr_array((costs, (self._before, self._after)), shape=(size, size)), indices=here, return_predecessors=True
        )
        goals = [goal for goal in goals if goal != here and np.isfinite(costs[goal])]
        way = [] if not goals else [min(goals, key=lambda goal: (costs[goal], goal))]
        while way and before[way[-1]] != here:
            way.append(int(before[way[-1]]))
        return way[::-1]
