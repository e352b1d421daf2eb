"""The plan of a city: a warped net of streets of several widths, the blocks between them, and functions for their geometry.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.scene import Array

COLUMNS, ROWS = 12, 10
"""Numbers of crossings of the net along x and along y; no drive goes to the outermost crossings."""
MEDIAN = 1.6
"""Half of the width of the strip between the two roadways of the dual carriageway [m]."""

StreetKind = Literal["street", "carriageway", "bridge", "footway"]
BlockKind = Literal["closed", "open", "halls", "square", "park", "river"]


class Profile(NamedTuple):
    """The cross section of a street, the same on both sides of its centre line."""

    half: float  # half of the roadway's width [m]
    verge: float  # width of the strip between roadway and houses [m]
    # distances of the lanes' centre lines from the street's centre line [m]; a drive uses the last lane on the right
    lanes: tuple[float, ...]
    speed: float  # usual speed of a drive [m/s]


@dataclass(frozen=True)
class Street:
    """A street from one crossing to the next."""

    ends: tuple[int, int]  # indices of its two crossings in `CityPlan.crossings`
    line: Array  # (K, 2) its centre line [m], from the first end to the second
    kind: StreetKind  # kind of the street; a footway has no vehicles
    profile: Profile  # its cross section

    @property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return float(np.hypot(*np.diff(self.line, axis=0).T).sum())

    def places(self, along: Array, left: float) -> tuple[Array, Array]:
        """Returns positions (N, 2) [m] beside the centre line, and the headings (N,) [rad] of the street there.

        Args:
            along: (N,) distances along the centre line [m].
            left: distance to the left of the centre line [m].
        """
        steps = np.diff(self.line, axis=0)
        lengths = np.hypot(*steps.T)
        begins = np.r_[0.0, np.cumsum(lengths)]
        piece = np.clip(np.searchsorted(begins, along, side="right") - 1, 0, len(steps) - 1)
        line = offset_line(self.line, np.full(len(steps), left), closed=False)
        share = ((along - begins[piece]) / lengths[piece])[:, None]
        return line[piece] + share * (line[piece + 1] - line[piece]), np.arctan2(steps[piece, 1], steps[piece, 0])


@dataclass(frozen=True)
class Block:
    """The area that four streets enclose."""

    kind: BlockKind  # kind of the houses or other things in the block
    outline: Array  # (K, 2) the centre lines of the streets around it [m], counter-clockwise
    insets: Array  # (K,) distance from each piece of the outline to the house line, behind which houses stand [m]
    fronts: tuple[Street, ...]  # (K,) the street along each piece of the outline


@dataclass(frozen=True)
class CityPlan:
    """The streets and blocks of a city."""

    crossings: Array  # (C, 2) positions of the crossings [m]
    streets: tuple[Street, ...]  # all streets
    blocks: tuple[Block, ...]  # all blocks

    def clearances(self) -> Array:
        """Returns for each crossing the distance (C,) [m] within which streets have no lamps, trees or parked vehicles."""
        reach = np.zeros(len(self.crossings))
        for street in self.streets:
            for end in street.ends:
                reach[end] = max(reach[end], street.profile.half + street.profile.verge)
        return reach

    def driven_streets(self) -> tuple[Street, ...]:
        """Returns the streets that a drive can use: all but footways and streets at the edge of the net."""
        return tuple(s for s in self.streets if s.kind != "footway" and _is_inside(s.ends))


def _is_inside(ends: tuple[int, int]) -> bool:
    """Returns whether both crossings of a street lie inside the net, not at its edge."""
    return all(0 < end // COLUMNS < ROWS - 1 and 0 < end % COLUMNS < COLUMNS - 1 for end in ends)


class _Sights(NamedTuple):
    """The positions of the dual carriageway, the river, its bridges and the park in the net of a city's streets."""

    carriageway: int  # index of the row of streets that is the dual carriageway
    river: int  # index of the row of blocks in which the river runs
    bridges: frozenset[int]  # indices of the columns of streets that cross the river
    park: tuple[int, int]  # column and row of blocks in which the park begins; it is two by two blocks


def lay_plan(seed: int) -> CityPlan:
    """Lays the streets and blocks of a city; another seed gives another city."""
    rng = np.random.default_rng([seed, 4])
    sights = _choose_sights(rng)
    crossings = _place_crossings(rng, sights.carriageway)
    streets = _lay_streets(rng, crossings, sights)
    blocks = tuple(
        _make_block(rng, streets, column, row, sights) for row in range(ROWS - 1) for column in range(COLUMNS - 1)
    )
    return CityPlan(crossings, tuple(streets.values()), blocks)


def _choose_sights(rng: np.random.Generator) -> _Sights:
    """Chooses at random where carriageway, river, bridges and park are, away from the edge of the city."""
    carriageway = int(rng.integers(3, 7))
    river = int(rng.choice([r for r in range(2, 7) if r not in (carriageway - 1, carriageway)]))
    column = int(rng.integers(1, 4))
    bridges = frozenset({column, column + 3, column + 6})
    park_rows = [r for r in range(1, ROWS - 3) if river not in (r, r + 1) and r + 1 != carriageway]
    return _Sights(carriageway, river, bridges, (int(rng.integers(3, 7)), int(rng.choice(park_rows))))


def _place_crossings(rng: np.random.Generator, carriageway: int) -> Array:
    """Returns the crossings (C, 2) [m] of an uneven grid, displaced by long waves and at random.

    The crossings in the row with the index `carriageway` are not displaced at random along y, so that this row runs
    smoothly.
    """
    x, y = (np.r_[0.0, np.cumsum(rng.uniform(*span, n - 1))] for n, span in ((COLUMNS, (78, 165)), (ROWS, (66, 120))))
    grid = np.stack(np.meshgrid(x - x.mean(), y - y.mean()), axis=-1)
    moves = rng.uniform(-7.0, 7.0, grid.shape)
    moves[carriageway, :, 1] = 0.0
    lengths, phases = rng.uniform(560.0, 960.0, (2, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 2))
    waves = [12.0 * np.sin(2.0 * np.pi * grid / lengths[k] + phases[k]).sum(axis=-1) for k in (0, 1)]
    return np.asarray(grid + moves + np.stack(waves, axis=-1)).reshape(-1, 2)


def _lay_streets(rng: np.random.Generator, crossings: Array, sights: _Sights) -> dict[tuple[int, int], Street]:
    """Lays a street between each two neighbours among crossings (C, 2) [m]; returns the streets by their ends' indices.

    Some streets become footways, so that drives go round blocks of different sizes.
    Every crossing that vehicles reach keeps two streets that lead on, so that no drive ends in a blind alley.
    """
    along_x = [_draw_profile(rng) for _ in range(ROWS)]
    along_y = [_draw_profile(rng) for _ in range(COLUMNS)]
    lanes = (MEDIAN + 1.75, MEDIAN + 5.25)
    along_x[sights.carriageway] = Profile(MEDIAN + 7.0, rng.uniform(9.0, 14.0), lanes, 15.5)
    degrees = np.zeros(len(crossings), dtype=np.int64)
    kinds: dict[tuple[int, int], StreetKind] = {}
    for row in range(ROWS):
        for column in range(COLUMNS):
            here = row * COLUMNS + column
            for is_row, there in ((True, here + 1), (False, here + COLUMNS)):
                if (column + 1 < COLUMNS) if is_row else (row + 1 < ROWS):
                    kinds[here, there] = _name_street(is_row, column, row, sights)
                    degrees[[here, there]] += kinds[here, there] != "footway" and _is_inside((here, there))
    for number in rng.permutation(len(kinds)):
        ends = list(kinds)[number]
        if kinds[ends] == "street" and _is_inside(ends) and degrees[list(ends)].min() > 3 and rng.random() < 0.2:
            kinds[ends] = "footway"
            degrees[list(ends)] -= 1
    return {
        ends: _lay_street(
            rng, crossings, ends, kind, along_x[ends[0] // COLUMNS] if ends[1] == ends[0] + 1 else along_y[ends[0] % COLUMNS]
        )
        for ends, kind in kinds.items()
    }


def _name_street(is_row: bool, column: int, row: int, sights: _Sights) -> StreetKind:
    """Returns the kind of the street that begins at the crossing in a column and row, and leads along x (`is_row`) or y."""
    across, up = sights.park
    if is_row:
        if row == sights.carriageway:
            return "carriageway"
        return "footway" if row == up + 1 and across <= column <= across + 1 else "street"
    if row == sights.river:
        return "bridge" if column in sights.bridges else "footway"
    return "footway" if column == across + 1 and up <= row <= up + 1 else "street"


def _draw_profile(rng: np.random.Generator) -> Profile:
    """Draws the cross section of all streets of a row or column: main streets, side streets or narrow streets."""
    chance = rng.random()
    if chance < 0.35:
        half, verge, speed = rng.uniform(3.8, 4.8), rng.uniform(7.0, 9.5), 13.5
    elif chance < 0.8:
        half, verge, speed = rng.uniform(3.3, 3.7), rng.uniform(5.6, 7.5), 11.0
    else:
        half, verge, speed = rng.uniform(2.9, 3.1), rng.uniform(2.8, 3.6), 8.0
    return Profile(half, verge, (0.5 * half,), speed)


def _lay_street(
    rng: np.random.Generator, crossings: Array, ends: tuple[int, int], kind: StreetKind, profile: Profile
) -> Street:
    """Lays the street between the crossings with the indices `ends`, straight or with a bend near its midpoint."""
    a, b = crossings[list(ends)]
    if kind == "footway":
        profile = Profile(1.0, rng.uniform(0.8, 2.5), (), 0.0)
    elif kind == "bridge":
        profile = profile._replace(verge=2.0)
    elif kind == "street":
        profile = profile._replace(verge=profile.verge + rng.uniform(-0.4, 1.2))
    if kind not in ("street", "footway") or rng.random() < 0.35:
        return Street(ends, np.array([a, b]), kind, profile)
    middle = a + rng.uniform(0.4, 0.6) * (b - a) + rng.uniform(-0.07, 0.07) * np.array([a[1] - b[1], b[0] - a[0]])
    return Street(ends, np.array([a, middle, b]), kind, profile)


def _make_block(
    rng: np.random.Generator, streets: dict[tuple[int, int], Street], column: int, row: int, sights: _Sights
) -> Block:
    """Makes the block whose corner with the least column and row is the crossing at `column` and `row`."""
    corner = row * COLUMNS + column
    above = corner + COLUMNS
    around = [((corner, corner + 1), 1), ((corner + 1, above + 1), 1), ((above, above + 1), -1), ((corner, above), -1)]
    outline: list[Array] = []
    fronts: list[Street] = []
    for ends, way in around:
        street = streets[ends]
        outline.extend(street.line[::way][:-1])
        fronts.extend([street] * (len(street.line) - 1))
    chance = rng.random()
    kind: BlockKind = "closed" if chance < 0.55 else "open" if chance < 0.82 else "halls" if chance < 0.95 else "square"
    if row == sights.river:
        kind = "river"
    elif 0 <= column - sights.park[0] <= 1 and 0 <= row - sights.park[1] <= 1:
        kind = "park"
    insets = np.array([street.profile.half + street.profile.verge for street in fronts])
    return Block(kind, np.array(outline), insets, tuple(fronts))


def offset_line(line: Array, distances: Array, *, closed: bool) -> Array:
    """Moves every piece of a polyline to its left, and lengthens or shortens the moved pieces so that they meet again.

    Args:
        line: (N, 2) points [m]; the last point of a closed line is joined to the first one.
        distances: (N,) distance by which each piece is moved [m]; (N - 1,) for a line that is not closed.
        closed: whether the line is a polygon.

    Returns:
        The moved points (N, 2) [m].
    """
    after = np.roll(line, -1, axis=0) if closed else line[1:]
    along = after - line[: len(after)]
    along /= np.hypot(*along.T)[:, None]
    normal = np.c_[-along[:, 1], along[:, 0]]
    first, second = np.arange(len(line)) - 1, np.arange(len(line))  # the pieces before and after each point
    if not closed:
        first[0], second[-1] = 0, len(along) - 1
    n, m, a, b = normal[first], normal[second], distances[first], distances[second]
    cross = n[:, 0] * m[:, 1] - n[:, 1] * m[:, 0]
    straight = np.abs(cross) < 1e-3
    cross[straight] = 1.0
    meet = np.c_[a * m[:, 1] - b * n[:, 1], b * n[:, 0] - a * m[:, 0]] / cross[:, None]
    meet[straight] = 0.5 * (a[:, None] * n + b[:, None] * m)[straight]
    return np.asarray(line + meet)


def contains(polygon: Array, points: Array) -> NDArray[np.bool_]:
    """Returns for each of the points (N, 2) [m] whether it lies in a polygon (K, 2) [m], as an array (N,)."""
    x, y = points[:, :1], points[:, 1:]
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crossed = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(crossed, b[:, 1] - a[:, 1], 1.0)
    return np.asarray(np.sum(crossed & (x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])), axis=1) % 2 == 1)


def distance_to_pieces(points: Array, starts: Array, ends: Array) -> Array:
    """Returns the distances (N, K) [m] of points (N, 2) from straight pieces, given by starts and ends (K, 2)."""
    along = ends - starts
    late = points[:, None] - starts
    share = np.clip((late * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(late - share[..., None] * along, axis=2))


def draw_inside(rng: np.random.Generator, polygon: Array, number: int) -> Array:
    """Draws `number` points in the box around a polygon (K, 2) [m], and returns the points (M, 2) [m] inside the polygon."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = rng.uniform(low, high, (number, 2))
    return np.asarray(points[contains(polygon, points)])
