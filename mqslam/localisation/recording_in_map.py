"""Localisation on one screen: cold start, following, how sure it is, and predictions where the map shows nothing.

Everything happens after the recording. Scans are therefore followed from a recognised place in both directions of time, and
a place that is recognised late serves the scans before it, too.

The covariance of psi's curvature is too small by a factor that depends on the world: returns of one object move together as
it is seen from elsewhere, and keyframes err within the map. Two scans that are some metres apart, each laid on one half of
the keyframes around it, differ by the errors of both, besides that of the short way between them. Where the front end's
motions are poor, the factor is too large rather than too small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import TOLERANCES
from mqslam.backend.loops.submap import MappedDrive, TrackedRun
from mqslam.backend.recognition.place_index import PlaceIndex
from mqslam.backend.recognition.places import PLACE_SPACING_M, describe_map
from mqslam.backend.recognition.recognise import ROW, Ground, PlaceMatch, recognise
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.core.statistics import find_usual_scale
from mqslam.core.wording import count_of
from mqslam.errors import NotInMapError
from mqslam.execution.runner import Runner
from mqslam.localisation.localised import Localised, PlaceStatus
from mqslam.localisation.registering import REACH_M, MapAround, Prediction, Registered, register
from mqslam.localisation.scan_by_scan import LocalisedScans, Setting, follow
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam

# Path [m] between the scans that show by which factors the covariances are too small.
_SAMPLE_M = 20.0
# Path [m] between two scans that are laid on keyframes which they do not share, to see how far they disagree. Over a shorter
# path they see the same side of everything and err alike, over a longer one the motions between them err, too.
_APART_M = 5.0
# With fewer such pairs the recording does not show these factors.
FEWEST_PAIRS = 20
# Factor on the variances of psi's curvature where the recording is too short to show it. Drives through cities have shown 6
# to 13.
_USUAL_SCALE = 10.0

_BATCH: Final = 64  # pairs that one call compares: a matter of speed only


def measure_scale(setting: Setting, table: LocalisedScans, engine: Engine) -> tuple[NDArray[np.float64], int]:
    """Returns the factors (3,) that psi's variances need, and the number of pairs of scans that show them.

    Args:
        setting: what the scans were followed with.
        table: where each lies in the map.
        engine: where pairs are compared; the result does not depend on it.
    """
    travelled = setting.drive.travelled
    converged = np.array([status is PlaceStatus.CONVERGED for status in table.statuses], dtype=np.bool_)
    pairs = []
    for k in pick_spaced(travelled, _SAMPLE_M).tolist():
        n = int(np.searchsorted(travelled, travelled[k] + _APART_M))
        if n < len(travelled) and converged[k : n + 1].all() and travelled[n] - travelled[k] <= 2.0 * _APART_M:
            pairs.append((k, n))
    lying = [
        ((k, Prediction(table.poses[k], table.covariances[k])), (n, Prediction(table.poses[n], table.covariances[n])))
        for k, n in pairs
    ]
    batches = [lying[begin : begin + _BATCH] for begin in range(0, len(lying), _BATCH)]
    parts = engine.map(_compare, setting, batches)
    squares = np.concatenate([np.empty((0, 3)), *parts])
    if len(squares) < FEWEST_PAIRS:
        return np.full(3, _USUAL_SCALE), len(squares)
    return find_usual_scale(squares), len(squares)


def _compare(setting: Setting, pairs: list[tuple[tuple[int, Prediction], tuple[int, Prediction]]]) -> NDArray[np.float64]:
    """Returns the squares (K, 3) by which pairs of scans disagree, in units of the variances of psi's curvature."""
    even = np.arange(len(setting.keyframes)) % 2 == 0
    halves = [MapAround(setting.keyframes, setting.beam, chosen) for chosen in (even, ~even)]
    squares = []
    for pair in pairs:
        first, second = (_lay(setting, half, *one) for half, one in zip(halves, pair, strict=True))
        if not first.status == second.status == PlaceStatus.CONVERGED:
            continue
        step = se2.between(*(setting.drive.poses[k] for k, _ in pair))
        off = se2.wrapped_between(se2.compose(first.pose, step), second.pose)
        back = se2.adjoint(se2.inverse(step))
        squares.append(off**2 / np.diag(back @ first.covariance @ back.T + second.covariance))
    return np.array(squares).reshape(-1, 3)


def _lay(setting: Setting, half: MapAround, k: int, expected: Prediction) -> Registered:
    """Returns where a scan lies on half of the map, of which it is expected where it lies on all of it."""
    roughly = Prediction(expected.pose, expected.covariance + np.diag(TOLERANCES**2))
    return register(half, setting.render(k), roughly, setting.estimator)


# Least share of the scans along a row of recognised places that must lie on the map for it to count.
_CONFIRMED = 0.7
# Number of submaps that are looked up at a time, until a row of them is recognised.
_BLOCK = 6

_OTHER_MAP: Final = "give the map of a recording that has passed the same streets"
_LONGER: Final = "give a longer recording, or more of it"


class _Found(NamedTuple):
    """What looking up some submaps has led to.

    Args:
        rows: rows of places that agree.
        looked_up: number of submaps.
        ambiguous: number of these that fit several places about as well.
    """

    rows: list[list[PlaceMatch]]
    looked_up: int
    ambiguous: int


def localise(
    scans: Scans, motions: Sequence[Measurement], made: KeyframeMap, estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> Localised:
    """Returns where the scans of a recording lie in a map, of which nothing is known beforehand.

    Args:
        scans: N scans of the recording.
        motions: N - 1 motions between successive scans.
        made: the map.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: does the work, and times it.

    Raises:
        NotInMapError: no place of the map was recognised.
    """
    poses = se2.chain(motion.pose for motion in motions)
    setting = Setting(TrackedRun.of(scans, poses), motions, made.keyframes, estimator, beam)
    table, rows, looked_up, ambiguous, conflicts = LocalisedScans(len(scans), runner.progress), 0, 0, 0, 0
    with runner.time_stage("recognise"):
        wanted = np.ones(len(scans), dtype=np.bool_)
        parts = _look_up(setting, made, runner.engine, wanted)
        found = next(parts, None)
    while found is not None:
        looked_up, ambiguous = looked_up + found.looked_up, ambiguous + found.ambiguous
        for row in found.rows:
            with runner.time_stage("follow"):
                if _seed(setting, table, row):
                    rows += 1
                    conflicts += _follow_on(setting, table, row)
        wanted[:] = ~table.tried
        with runner.time_stage("recognise"):
            found = next(parts, None)
    if not rows:
        raise NotInMapError(*_say_what_was_tried(setting.drive, made, looked_up, ambiguous))
    with runner.time_stage("surety"):
        scale, samples = measure_scale(setting, table, runner.engine)
    _fill_in(setting, table, se2.scale_covariance(table.covariances, scale))
    return Localised(
        stamps_us=scans.stamps_us,
        poses=table.poses,
        covariances=table.covariances,
        statuses=tuple(table.statuses),
        psi=table.psi,
        matched=table.matched,
        rows=rows,
        looked_up=looked_up,
        ambiguous=ambiguous,
        scale=scale,
        samples=samples,
        conflicts=conflicts,
        is_scale_measured=samples >= FEWEST_PAIRS,
    )


def _look_up(setting: Setting, made: KeyframeMap, engine: Engine, wanted: NDArray[np.bool_]) -> Iterator[_Found]:
    """Yields what looking up some submaps after the other leads to, as long as there are wanted ones.

    The last submaps of each part are looked up again in the next one, so that a row that reaches into it is found.

    Args:
        setting: the scans and the map.
        made: the map with its places.
        engine: where submaps are compared; the result does not depend on it.
        wanted: (N,) which scans are still to be found. The caller may change it as it goes on.
    """
    places = describe_map(made, setting.beam, engine).places
    ground = Ground(MappedDrive.of(made.keyframes), places.keyframes, PlaceIndex(places.descriptors))
    nodes = pick_spaced(setting.drive.travelled, PLACE_SPACING_M)
    for begin in range(0, len(nodes), _BLOCK - ROW + 1):
        part = nodes[begin : begin + _BLOCK]
        fresh = part if begin == 0 else part[ROW - 1 :]
        if wanted[fresh].any():
            allowed = np.ones((len(part), len(ground.places)), dtype=np.bool_)
            found = recognise(setting.drive, part, ground, allowed, setting.estimator, setting.beam, engine)
            yield _Found(found.rows, len(fresh), len(set(found.ambiguous) & set(fresh.tolist())))


def _seed(setting: Setting, table: LocalisedScans, row: Sequence[PlaceMatch]) -> bool:
    """Follows the scans along a row of recognised places, and returns whether enough of them lie on the map.

    Where they do not, the table is left as it was.
    """
    first, last = row[0].query, row[-1].query
    if table.tried[first : last + 1].any():
        return False
    middle = row[len(row) // 2]
    around = MapAround(setting.keyframes, setting.beam)
    expected = Prediction(se2.compose(setting.keyframes.poses[middle.place], middle.pose), middle.covariance)
    lying = register(around, setting.render(middle.query), expected, setting.estimator)
    if lying.status is not PlaceStatus.CONVERGED:
        return False
    table.put(middle.query, lying)
    for way, limit in ((1, last), (-1, first)):
        follow(setting, table, middle.query, way, limit)
    if table.on_map[first : last + 1].mean() >= _CONFIRMED:
        return True
    table.forget(slice(first, last + 1))
    return False


def _follow_on(setting: Setting, table: LocalisedScans, row: Sequence[PlaceMatch]) -> int:
    """Follows scans on from both ends of a row; returns at how many ends they meet scans that lie elsewhere."""
    along = row[0].query + np.flatnonzero(table.on_map[row[0].query : row[-1].query + 1])
    ends = ((int(along[-1]), 1, len(table.tried) - 1), (int(along[0]), -1, 0))
    return sum(follow(setting, table, start, way, limit) for start, way, limit in ends)


def _fill_in(setting: Setting, table: LocalisedScans, covariances: NDArray[np.float64]) -> None:
    """Predicts the scans that do not lie on the map from the nearest one that does, with its covariance (N, 3, 3)."""
    travelled, known = setting.drive.travelled, table.on_map.copy()
    table.covariances[:] = covariances
    nearest = np.full(len(known), np.inf)
    for way in (1, -1):
        source = None
        for k in range(len(known))[::way]:
            if known[k]:
                source, now = k, table.get(k)
                continue
            if source is None:
                continue
            now = setting.predict(now, k - way, k)
            away = abs(travelled[k] - travelled[source])
            if away < nearest[k]:
                nearest[k] = away
                table.poses[k], table.covariances[k] = now
    tree = cKDTree(setting.keyframes.poses[:, :2])
    for k in np.flatnonzero(~known).tolist():
        is_outside = tree.query(table.poses[k, :2])[0] > REACH_M
        table.statuses[k] = PlaceStatus.OUTSIDE if is_outside else PlaceStatus.LOST


def _say_what_was_tried(drive: TrackedRun, made: KeyframeMap, looked_up: int, ambiguous: int) -> tuple[str, str]:
    """Returns why a recording is nowhere in a map, with what was tried, and what the user can do."""
    path_m = float(drive.travelled[-1])
    if looked_up < ROW:
        too_short = (
            f"not found in this map: its path of {path_m:.0f} m is too short, as {ROW} places that are "
            f"{PLACE_SPACING_M:g} m apart must be recognised in a row"
        )
        return too_short, _LONGER
    along, places = f"submaps along {path_m:.0f} m of path", count_of(len(made.places.keyframes), "place")
    if 2 * ambiguous > looked_up:
        fit = f"{ambiguous} of {looked_up} {along} fit more than one of {places} about as well"
        return f"several places of this map fit, and nothing tells which one it is ({fit})", _LONGER
    fits = f"; {ambiguous} of them fit several places about as well" if ambiguous else ""
    return f"not in this map: no row of places was recognised ({looked_up} {along}, {places}{fits})", _OTHER_MAP
