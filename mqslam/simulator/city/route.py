"""A route through the streets of a city, that comes back to where it was, on the same side of the street and on the other.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mqslam.simulator.city.streets import CityPlan, Street
from mqslam.simulator.parts import Array

OUTWARD = 300.0
"""Length [m] after which the way to something new turns back."""
LONGEST = 1300.0
"""Length [m] of a round from which on it turns back earlier."""
AGAIN = 2.0
"""Factor by which a street driven before counts as longer, where a round looks for its way."""
LONGEST_BACK = 1100.0
"""Length [m] of a round and of the way to turn round after it, up to which it is driven backwards."""


class Course(NamedTuple):
    """A street driven in one direction.

    Args:
        street: the street.
        way: 1 from its first end to its second, -1 the other way.
    """

    street: Street
    way: int

    @property
    def start(self) -> int:
        """Number of the crossing that it leaves."""
        return self.street.ends[0 if self.way == 1 else 1]

    @property
    def end(self) -> int:
        """Number of the crossing that it reaches."""
        return self.street.ends[1 if self.way == 1 else 0]

    @property
    def line(self) -> Array:
        """Middle (K, 2) [m] of the street, as driven."""
        return self.street.line[:: self.way]


def plan_route(seed: int, plan: CityPlan, length: float) -> list[Course]:
    """Plans a route of rounds through several blocks each, without turning round in a street.

    A round leads out to something new and back by other streets. Each is driven twice: every other one
    backwards, if it is short. Then the route goes on to where the next begins.

    Args:
        seed: of the route.
        plan: the city.
        length: that the route reaches at least [m].
    """
    rng = np.random.default_rng([seed, 8])
    courses = [Course(street, way) for street in plan.driven_streets() for way in (1, -1)]  # k ^ 1 is the way back of k
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
    """Returns the courses of a round that begins after the course `base` and ends with it.

    Args:
        net: the courses of the city.
        base: where the round begins and ends.
        goals: courses that are worth a visit; the nearest comes first.
        driven: (C,) which courses lie in streets driven before.
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
    """Returns the way after the course `here` to the nearest street of a round, and the whole round backwards."""
    tour = [k ^ 1 for k in tour[::-1]]
    way = net.find_way(here, tour, np.ones(len(net.lengths)))
    begin = tour.index(way[-1])
    return way[:-1] + tour[begin:] + tour[:begin]


class _Net:
    """The courses of a city, their lengths [m], and which of them follow each other: all but the way back.

    Args:
        courses: all courses that can be driven.
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
        """Returns which courses lie in streets that a route uses in one direction or the other."""
        return np.isin(np.arange(len(self.lengths)) // 2, np.array(route) // 2)

    def find_way(self, here: int, goals: list[int], factors: NDArray[np.float64]) -> list[int]:
        """Returns the courses after `here` of the shortest way to the nearest goal, with lengths times their factors."""
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
