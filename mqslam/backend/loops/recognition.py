"""Recognises places by their appearance: finds the place that a submap shows, wherever the submap lies in the map.

A place is described by the counts of returns in rings and sectors around it. psi registers a submap on the places that look
most like it. A single place may match another one by chance, but several successive submaps hardly match successive places
by chance. Streets that look alike are an exception: there a submap matches several places, and all these matches are
rejected.

Source: Scan Context (Kim and Kim, IROS 2018), with counts of returns in place of heights, which a radar does not measure.
From another lane, returns lie in other rings and sectors. A submap is therefore described from several positions to the left
and right of its centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mqslam.backend.loops.passes import MATCHED, MappedDrive, Passes, render_passes, render_submap
from mqslam.backend.loops.registration import RIVAL, align_passes, is_unrivalled
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.core.measurement import Loop
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.correlate import compute_same_m
from mqslam.psi.place import Beam, PointSet

# Returns farther away from a place than this [m] are not part of its description.
RANGE_M = 120.0
# Number of rings around a place in which returns are counted. Each ring is 3 m wide, about as wide as a lane.
RINGS = 40
# Number of sectors around a place in which returns are counted. Each sector is 3 degrees wide.
SECTORS = 120
PLACE_SPACING_M: Final = 10.0
"""Path [m] between the places that are described, and between the submaps that are looked up."""
PLACE_SUBMAP_M: Final = 15.0
"""A place is described by the returns of scans within this path [m] to either side."""
DESCRIBED_WITH: Final = {
    "spacing_m": PLACE_SPACING_M,
    "submap_m": PLACE_SUBMAP_M,
    "range_m": RANGE_M,
    "rings": RINGS,
    "sectors": SECTORS,
}
"""The constants that descriptors depend on; they are stored with the descriptors."""


def describe_places(drive: Passes, beam: Beam, engine: Engine) -> PlaceTable:
    """Describes places that are PLACE_SPACING_M apart on a path by the returns around them.

    Args:
        drive: scans under a trajectory.
        beam: the sensor's measurement errors.
        engine: engine that describes the places; the result does not depend on it.
    """
    places = pick_spaced(drive.travelled, PLACE_SPACING_M)
    descriptors = engine.map(_describe, (drive, beam), places.tolist())
    table = np.array(descriptors, dtype=np.float16).reshape(-1, RINGS, SECTORS)
    return PlaceTable(places, table, dict(DESCRIBED_WITH))


def describe_map(made: KeyframeMap, beam: Beam, engine: Engine) -> KeyframeMap:
    """Returns the map with descriptors of its places that are made with `DESCRIBED_WITH`; others are made anew."""
    if made.places.made_with == DESCRIBED_WITH:
        return made
    return replace(made, places=describe_places(MappedDrive.of(made.keyframes), beam, engine))


def _describe(shared: tuple[Passes, Beam], place: int) -> NDArray[np.float32]:
    """Returns the descriptor of the submap around the scan `place`; `shared` holds the scans and the sensor's errors."""
    return describe(_render(shared, place).points)


def render_places(drive: Passes, places: Sequence[int], beam: Beam, engine: Engine) -> list[PointSet]:
    """Renders the submaps of some places, each in the frame of its central scan.

    Args:
        drive: scans under a trajectory.
        places: numbers of the central scans.
        beam: the sensor's measurement errors.
        engine: engine that renders the submaps; the result does not depend on it.
    """
    return engine.map(_render, (drive, beam), list(places))


def _render(shared: tuple[Passes, Beam], place: int) -> PointSet:
    """Renders the submap around the scan `place` in this scan's frame; `shared` holds the scans and the sensor's errors."""
    drive, beam = shared
    return render_submap(drive, place, PLACE_SUBMAP_M, beam)


def describe(points: NDArray[np.float64], aside_m: float = 0.0) -> NDArray[np.float32]:
    """Describes a place by the square roots of the counts of returns in rings and sectors, scaled to unit norm.

    Args:
        points: (N, 2) m, in a frame at the place.
        aside_m: how far to the left of the place the rings are centred [m].

    Returns:
        The descriptor (R, S), with rings from the inside out, and sectors counter-clockwise from straight ahead; all zeros
        if no return is in range.
    """
    roots = np.sqrt(_count(np.asarray(points, dtype=np.float64), aside_m))
    norm = float(np.linalg.norm(roots))
    return np.asarray(roots / norm if norm > 0.0 else roots, dtype=np.float32)


@nb.njit(cache=True, nogil=True)
def _count(points: NDArray[np.float64], aside_m: float) -> NDArray[np.float64]:
    """Counts points (N, 2) [m] in rings and sectors (R, S) around a centre that lies `aside_m` to the left of the origin."""
    counts = np.zeros((RINGS, SECTORS))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1] - aside_m
        ring = int(np.hypot(x, y) / RANGE_M * RINGS)
        if ring < RINGS:
            sector = int(np.floor(np.arctan2(y, x) / (2.0 * np.pi) * SECTORS)) % SECTORS
            counts[ring, sector] += 1.0
    return counts


# A place is also recognised from positions up to this far to either side [m], such as from another lane. Without such
# shifts, half of the places that are passed in the opposite direction are not found.
ASIDE_M = 9.0
# Number of places, those that look most like a submap, that psi compares with the submap.
_GUESSES = 3
# Distance [m] between the sideways shifts that are tried.
_ASIDE_STEP_M = 3.0

_COMPARED: Final = 4_000_000  # number of correlations that are in memory at a time; affects only memory and speed


class Guess(NamedTuple):
    """A place that looks like a submap.

    Args:
        place: index of the place in the `PlaceIndex`.
        pose: (3,) pose of the submap's frame in the place's frame, as the descriptors show it [m, m, rad].
        likeness: correlation of the two descriptors, at most 1.
    """

    place: int
    pose: se2.Array
    likeness: float


class PlaceIndex:
    """An index of places, which finds the places that look most like a submap.

    Args:
        descriptors: (P, R, S) descriptors of the places, as `describe` makes them.
    """

    def __init__(self, descriptors: NDArray[np.floating]) -> None:
        spectra = fft.rfft(np.asarray(descriptors, dtype=np.float32), axis=2)
        self._spectra = np.ascontiguousarray(np.moveaxis(spectra, 2, 0).conj())  # (F, P, R)

    def __len__(self) -> int:
        return int(self._spectra.shape[1])

    def look_up(
        self, queries: Sequence[NDArray[np.float64]], allowed: NDArray[np.bool_], apart: Sequence[NDArray[np.int64]]
    ) -> list[list[Guess]]:
        """Returns for each submap at most `_GUESSES` places that look most like it, the likeliest first.

        Args:
            queries: (N, 2) points of each of Q submaps, in the submap's own frame [m].
            allowed: (Q, P) whether the place of a column may be an answer to the query of a row.
            apart: for each place, the indices of the places that show the same returns, with itself among them. Of these
                places, only the likeliest is returned.
        """
        steps = int(ASIDE_M / _ASIDE_STEP_M)
        asides = _ASIDE_STEP_M * np.arange(-steps, steps + 1, dtype=np.float64)
        block = max(1, _COMPARED // (len(asides) * max(len(self), 1) * SECTORS))
        answers: list[list[Guess]] = []
        for begin in range(0, len(queries), block):
            part = slice(begin, begin + block)
            likeness, shifts, turns = self._compare(queries[part], asides)
            likeness[~allowed[part]] = -1.0
            yaws = -se2.wrap(turns * 2.0 * np.pi / SECTORS)
            answers += [_choose_likeliest(*row, apart) for row in zip(likeness, asides[shifts], yaws, strict=True)]
        return answers

    def _compare(
        self, queries: Sequence[NDArray[np.float64]], asides: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """Compares Q submaps with all P places; each submap is described from centres `asides` [m] (A,) to its left.

        Returns:
            Three arrays (Q, P): the largest correlation, the index in `asides` at which it is found, and the number of
            sectors by which the submap's descriptor must then be rotated to fit the descriptor of the place.
        """
        described = np.array([describe(points, float(aside)) for points in queries for aside in asides])
        spectra = np.moveaxis(fft.rfft(described, axis=2), 2, 0)  # (F, Q * A, R)
        products = spectra @ np.swapaxes(self._spectra, 1, 2)  # (F, Q * A, P)
        correlations = fft.irfft(products, n=SECTORS, axis=0)  # (S, Q * A, P)
        turns = correlations.argmax(axis=0).reshape(len(queries), len(asides), -1)
        highest = correlations.max(axis=0).reshape(len(queries), len(asides), -1)
        best = highest.argmax(axis=1)
        likeness, turn = (np.take_along_axis(table, best[:, None], axis=1)[:, 0] for table in (highest, turns))
        return likeness, best, turn


def _choose_likeliest(
    likeness: NDArray[np.float32],
    asides: NDArray[np.float64],
    yaws: NDArray[np.float64],
    apart: Sequence[NDArray[np.int64]],
) -> list[Guess]:
    """Returns at most `_GUESSES` places that look like a submap, the likeliest first.

    Args:
        likeness: (P,) correlation of the submap with each place.
        asides: (P,) distance [m] to the left of the submap's centre from which its descriptor fits each place best.
        yaws: (P,) yaw of the submap in the frame of each place [rad].
        apart: for each place, the indices of the places that show the same returns, with itself among them.
    """
    chosen: list[Guess] = []
    left = likeness.copy()
    while len(chosen) < _GUESSES and len(left):
        place = int(left.argmax())
        if left[place] <= 0.0:
            break
        yaw = float(yaws[place])
        x, y = -se2.transform(np.array([0.0, 0.0, yaw]), np.array([[0.0, asides[place]]]))[0]
        chosen.append(Guess(place, np.array([x, y, yaw]), float(likeness[place])))
        left[apart[place]] = -1.0
    return chosen


# Registration by psi searches this far in position [m] and in yaw [rad] around the pose that the descriptors show.
_SEARCH = (10.0, 0.1)
# Least number of successive matches that must agree for a place to count as recognised. A single match may be wrong where
# streets look alike.
ROW = 3
# Longest path [m] between two matches that are compared with each other.
_GAP_M = 25.0
# Largest distance [m] by which two matches may disagree; a share of the path between them is added to this distance.
_AGREE_M = 0.5
# Largest yaw [rad] by which two matches may disagree.
_AGREE_RAD = 0.03
# Share of the path between two matches that is added to _AGREE_M, for errors of the odometry.
_AGREE_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Recognition:
    """The result of a recognition. A match is a loop from the scan at a place of the map to the central scan of a submap.

    Args:
        rows: groups of at least `ROW` matches that agree, in each group in the order of the drive.
        ambiguous: numbers of the central scans of submaps that match at several poses about equally well, at one place or at
            several.
        compared: number of pairs of a submap and a place that psi has compared.
    """

    rows: list[list[Loop]]
    ambiguous: list[int]
    compared: int


@dataclass(frozen=True, slots=True)
class PlaceDatabase:
    """The places of a map that can be recognised.

    Args:
        drive: the scans of the places, under the trajectory of the map.
        places: (P,) number of the scan at each place.
        index: index of the descriptors of these places, in the same order.
    """

    drive: Passes
    places: NDArray[np.int64]
    index: PlaceIndex

    @classmethod
    def of(cls, drive: Passes, table: PlaceTable) -> PlaceDatabase:
        """Makes the database of the places in a table, whose numbers of keyframes are numbers of scans of the drive."""
        return cls(drive, table.keyframes, PlaceIndex(table.descriptors))

    def find_same(self) -> list[NDArray[np.int64]]:
        """Returns for each place the indices of the places that lie within PLACE_SUBMAP_M of it on the path.

        These places, among them the place itself, show the same returns.
        """
        along = self.drive.travelled[self.places]
        order = np.argsort(along, kind="stable")
        firsts = np.searchsorted(along[order], along - PLACE_SUBMAP_M)
        ends = np.searchsorted(along[order], along + PLACE_SUBMAP_M, side="right")
        return [order[first:end] for first, end in zip(firsts, ends, strict=True)]


class Hypothesis(NamedTuple):
    """A scan, and a place that the submap around the scan may show.

    Args:
        earlier: number of the scan at the place, in the map.
        later: number of the scan around which the submap lies, in its drive.
        pose: (3,) approximate pose of the later scan in the frame of the earlier scan [m, m, rad].
        reach: how far the pose may be off in position [m] and in yaw [rad].
    """

    earlier: int
    later: int
    pose: se2.Array
    reach: tuple[float, float] = _SEARCH


def recognise(
    drive: Passes,
    queries: NDArray[np.int64],
    database: PlaceDatabase,
    allowed: NDArray[np.bool_] | None,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
    supposed: Sequence[Hypothesis] = (),
) -> Recognition:
    """Finds the places that submaps of a drive show, without knowing roughly where the submaps lie in the map.

    `PlaceIndex` guesses places for each submap. To save time, psi registers a guess only if it agrees with the guess of
    another submap. The best match of each submap is chosen, and matches that agree are grouped.

    Args:
        drive: scans under a trajectory that is accurate over short distances.
        queries: (Q,) numbers of the central scans of the submaps that are looked up, in the order of the path.
        database: the places.
        allowed: (Q, P) whether the place of a column may be an answer to the query of a row; None allows all.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        engine: engine that compares the submaps; the result does not depend on it.
        supposed: hypotheses that psi registers besides the guesses.
    """
    allowed = np.ones((len(queries), len(database.places)), dtype=np.bool_) if allowed is None else allowed
    if not allowed.any():
        return Recognition([], [], 0)
    rendered = render_places(drive, queries.tolist(), beam, engine)
    guesses = database.index.look_up([submap.points for submap in rendered], allowed, database.find_same())
    pairs = [
        Hypothesis(int(database.places[guess.place]), int(query), guess.pose)
        for query, listed in zip(queries, guesses, strict=True)
        for guess in listed
    ]
    i, k = _find_agreeing(pairs, drive, database.drive, _SEARCH)  # each guess must agree with the guess of another submap
    pairs = sorted([*(pairs[n] for n in np.union1d(i, k)), *supposed], key=lambda pair: pair.later)
    found = engine.map(_register, (drive, database.drive, estimator, beam), pairs)
    best, ambiguous = _choose([match for match in found if match is not None], database.drive, estimator)
    return Recognition(_find_rows(best, drive, database.drive), ambiguous, len(pairs))


def _place(pairs: Sequence[Hypothesis | Loop], mapped: Passes) -> se2.Array:
    """Returns the poses (K, 3) of the later scans in the map's frame [m, m, rad], as K pairs place them."""
    return np.array([se2.compose(mapped.poses[pair.earlier], pair.pose) for pair in pairs]).reshape(-1, 3)


def _find_agreeing(
    pairs: Sequence[Hypothesis | Loop], drive: Passes, mapped: Passes, slack: tuple[float, float]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Finds which of the given pairs agree with each other.

    Each pair places its later scan in the map. Two pairs agree if the motion between their later scans is nearly the same in
    the map as in the drive. Pairs whose later scans are the same, or more than `_GAP_M` of path apart, are not compared.

    Args:
        pairs: the pairs, in the order of their later scans.
        drive: the later scans, under their trajectory.
        mapped: the earlier scans, under the trajectory of the map.
        slack: largest disagreement in position [m], to which a share of the path between the later scans is added, and in
            yaw [rad].

    Returns:
        Two arrays (M,): the indices of the first and of the second pair of each two pairs that agree.
    """
    queries, found = np.array([pair.later for pair in pairs], dtype=np.int64), _place(pairs, mapped)
    along, poses = drive.travelled[queries], drive.poses[queries]
    ends = np.searchsorted(along, along + _GAP_M, side="right")
    i = np.repeat(np.arange(len(queries)), ends - np.arange(len(queries)))
    k = np.concatenate([np.arange(n, end) for n, end in enumerate(ends)]) if len(queries) else i
    apart = queries[i] != queries[k]
    i, k = i[apart], k[apart]
    expected = se2.compose(found[i], se2.between(poses[i], poses[k]))
    off = se2.wrapped_between(expected, found[k])
    path = along[k] - along[i]
    agree = np.hypot(off[:, 0], off[:, 1]) <= slack[0] + _AGREE_SHARE * path
    agree &= np.abs(off[:, 2]) <= slack[1]
    return i[agree], k[agree]


def _register(shared: tuple[Passes, Passes, EstimatorConfig, Beam], pair: Hypothesis) -> tuple[Loop, bool] | None:
    """Registers a submap on a place by psi.

    Args:
        shared: the submap's drive, the drive of the places, settings of the score, and the sensor's errors.
        pair: the central scan of the submap and the scan at the place, with their approximate relative pose.

    Returns:
        The match, and whether no other pose around the place fits about as well; None if the submap does not match, the pose
        is too uncertain, or there are too few returns.
    """
    drive, mapped, estimator, beam = shared
    submaps = render_passes((mapped, pair.earlier), (drive, pair.later), beam)
    found = align_passes(*submaps, pair.pose, pair.reach, estimator, on_surfaces=drive.shows_surfaces)
    if found is None:
        return None
    match = Loop(pair.earlier, pair.later, found.pose, found.covariance, found.matched, found.psi)
    return match, is_unrivalled(found, MATCHED)


def _choose(
    matches: Sequence[tuple[Loop, bool]], mapped: Passes, estimator: EstimatorConfig
) -> tuple[list[Loop], list[int]]:
    """Chooses the match with the lowest psi for each submap that fits at only one pose.

    Args:
        matches: pairs of a match and whether no other pose around its place fits about as well.
        mapped: the scans of the places.
        estimator: settings of the score.

    Returns:
        The chosen matches, and the numbers of the central scans of the submaps that fit at several poses.
    """
    chosen, ambiguous = [], []
    for query in sorted({match.later for match, _ in matches}):
        own = sorted(((match, alone) for match, alone in matches if match.later == query), key=lambda one: one[0].psi)
        (best, alone), found = own[0], _place([match for match, _ in own], mapped)
        is_elsewhere = np.hypot(*(found - found[0])[:, :2].T) > compute_same_m(estimator)
        rivalled = any(far and other.psi < RIVAL * best.psi for (other, _), far in zip(own, is_elsewhere, strict=True))
        if alone and not rivalled:
            chosen.append(best)
        else:
            ambiguous.append(query)
    return chosen, ambiguous


def _find_rows(matches: Sequence[Loop], drive: Passes, mapped: Passes) -> list[list[Loop]]:
    """Groups matches that agree, directly or through other matches; returns the groups of at least `ROW` matches.

    The matches must be in the order of the drive, with at most one per submap.
    """
    if not matches:
        return []
    i, k = _find_agreeing(matches, drive, mapped, (_AGREE_M, _AGREE_RAD))
    links = coo_array((np.ones(len(i), dtype=bool), (i, k)), shape=(len(matches), len(matches)))
    count, labels = connected_components(links, directed=False)
    rows = [[match for match, label in zip(matches, labels, strict=True) if label == n] for n in range(count)]
    return [row for row in rows if len(row) >= ROW]
