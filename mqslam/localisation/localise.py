"""Localises a recording in a map: recognises places, tracks scans from there, and predicts the poses of all other scans.

A row is a list of successive submaps of the recording that match successive places of the map. From a row, scans are tracked
both forward and backward in time, so that a place that is recognised late also helps to localise the scans before it. The
pose of each scan is predicted from a neighbouring scan by the front end's motion, and then registered on the map by psi.

The covariance from psi's curvature is too small by a factor that depends on the surroundings: the returns of an object shift
together when it is seen from another place, and the keyframes of the map have errors. To measure the factor, two scans some
metres apart are registered, each on a different half of the keyframes around them. Their poses differ by the errors of both
registrations, and by the small error of the motion between them. Poor motions of the front end make the factor too large
rather than too small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.passes import MappedDrive, TrackedRun
from mqslam.backend.loops.recognition import PLACE_SPACING_M, ROW, PlaceDatabase, describe_map, recognise
from mqslam.backend.loops.rigid import LEAST_COVARIANCE
from mqslam.config import EstimatorConfig
from mqslam.core import se2, units
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, Keyframes
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.scans import Scan, Scans
from mqslam.core.statistics import find_usual_scale
from mqslam.core.wording import count_of
from mqslam.errors import NotInMapError
from mqslam.execution.progress import Progress
from mqslam.execution.runner import Runner
from mqslam.localisation.registering import ON_MAP, REACH_M, MapAround, PlaceStatus, Registered, is_away, register
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam

# Tracking ends after this path [m] without a scan that lies on the map. Later scans are looked up in the map again.
_GIVE_UP_M = 30.0
# Path [m] between the pairs of scans from which the factors on the covariances are measured.
_SAMPLE_M = 20.0
# Path [m] between the two scans of such a pair, which are registered on different keyframes. On a shorter path both scans
# see the same sides of objects and have the same errors; on a longer path, the error of the motion between them matters.
_APART_M = 5.0
# With fewer pairs than this, the usual factor is used.
FEWEST_PAIRS = 20
# Factor on the variances from psi's curvature if the recording is too short to measure it. Drives through cities have shown
# 6 to 13.
_USUAL_SCALE = 10.0
# A row of recognised places is accepted if at least this share of the scans along it lies on the map.
_CONFIRMED = 0.7
# Number of successive submaps that are compared with the places of the map at a time.
_BLOCK = 6

_BATCH: Final = 64  # pairs of scans in one call of a worker: affects the speed only
_OTHER_MAP: Final = "give the map of a recording that passes the same places"
_LARGER_MAP: Final = "give a map with more places, made from a longer recording that passes the same places"
_LONGER: Final = "give a longer recording, or more of it"


@dataclass(frozen=True, slots=True, eq=False)
class Localised:
    """The poses of a recording's scans in a map, with counts of the steps by which they were found.

    Args:
        stamps_us: (N,) start of each scan [us].
        poses: (N, 3) poses of the radar at these stamps, in the map's frame [m, m, rad].
        covariances: (N, 3, 3) covariances of these poses relative to the map nearby, each in its pose's frame [m, m, rad].
        statuses: (N,) how far each pose can be trusted.
        psi: (N,) score per return on the map; NaN for scans that do not lie on the map.
        matched: (N,) share of the returns that lie on the map; NaN for scans that were not compared with the map, and for
            scans that tracking compared after the last scan that it found on the map.
        rows: number of rows of recognised places from which scans were tracked.
        looked_up: number of submaps of the recording that were compared with the places of the map.
        ambiguous: number of these submaps that fit several places of the map about equally well.
        scale: (3,) factors on the variances of x, y and yaw from psi's curvature, measured in this recording; the usual
            factor with fewer than `FEWEST_PAIRS` pairs.
        samples: number of pairs of scans that were compared to measure these factors.
        conflicts: number of times that tracking reached a scan to which tracking from the other side gave a different pose.
    """

    stamps_us: NDArray[np.int64]
    poses: se2.Array
    covariances: NDArray[np.float64]
    statuses: tuple[PlaceStatus, ...]
    psi: NDArray[np.float64]
    matched: NDArray[np.float64]
    rows: int
    looked_up: int
    ambiguous: int
    scale: NDArray[np.float64]
    samples: int
    conflicts: int

    def __len__(self) -> int:
        return len(self.stamps_us)

    def scale_lengths(self, factor: float) -> Localised:
        """Returns the result with all lengths of its poses and covariances multiplied by a factor."""
        covariances = units.scale_covariance(self.covariances, factor)
        return replace(self, poses=units.scale_pose(self.poses, factor), covariances=covariances)

    @property
    def on_map(self) -> NDArray[np.bool_]:
        """Whether each scan lies on the map (N,)."""
        return np.array([status in ON_MAP for status in self.statuses], dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class _Setting:
    """The data and settings that all steps of the localisation use.

    Args:
        drive: the scans under the front end's motions, chained without optimisation.
        motions: N - 1 motions between N successive scans.
        keyframes: keyframes of the map.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
    """

    drive: TrackedRun
    motions: Sequence[Measurement]
    keyframes: Keyframes
    estimator: EstimatorConfig
    beam: Beam

    def register(self, around: MapAround, k: int, expected: Registered) -> Registered:
        """Registers scan k on the map, starting from its expected pose; returns its pose in the map's frame and a status."""
        return register(around, self.drive.render(k, np.array([k]), self.beam), expected, self.estimator)

    def predict(self, known: Registered, k: int, n: int) -> Registered:
        """Predicts the pose of scan n from the known pose of scan k, the scan right before or after it."""
        motion = self.motions[min(k, n)]
        step, covariance = motion.pose, motion.covariance
        if n < k:
            step, covariance = se2.inverse(step), se2.covariance_of_inverse(step, covariance)
        back = se2.adjoint(se2.inverse(step))
        grown = se2.rotate_covariance(covariance, -float(step[2])) + back @ known.covariance @ back.T
        return Registered(se2.compose(known.pose, step), grown)


class _LocalisedScans:
    """The poses in the map that have been found so far, one for each scan of a recording.

    Args:
        count: number of scans.
        progress: called as scans are compared with the map.

    Attributes:
        poses, covariances, psi, matched, statuses: as in `Localised`.
        tried: (N,) whether the scan was compared with the map, and the result was stored (see `_follow`).
        on_map: (N,) whether the scan lies on the map.
    """

    def __init__(self, count: int, progress: Progress) -> None:
        self._progress = progress
        self.poses = np.full((count, 3), np.nan)
        self.covariances = np.full((count, 3, 3), np.nan)
        self.psi, self.matched = np.full(count, np.nan), np.full(count, np.nan)
        self.tried, self.on_map = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
        self.statuses = [PlaceStatus.LOST] * count

    def get(self, k: int) -> Registered:
        """Returns the pose of scan k in the map's frame, with its covariance; status and scores are left out."""
        return Registered(self.poses[k], self.covariances[k])

    def put(self, k: int, registered: Registered) -> None:
        """Stores the pose, status and scores of scan k, and reports the progress."""
        self.poses[k], self.covariances[k], self.statuses[k], self.psi[k], self.matched[k] = registered
        self.tried[k], self.on_map[k] = True, registered.status in ON_MAP
        self._progress("localise", int(self.tried.sum()), len(self.tried))

    def forget(self, part: slice) -> None:
        """Deletes the poses of the scans in a part of the recording; these scans then count as not tried."""
        self.poses[part] = self.covariances[part] = self.psi[part] = self.matched[part] = np.nan
        self.tried[part] = self.on_map[part] = False


def localise(
    scans: Scans, motions: Sequence[Measurement], made: KeyframeMap, estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> Localised:
    """Finds the poses of a recording's scans in a map, without an initial guess.

    Args:
        scans: N scans of the recording.
        motions: N - 1 motions between successive scans.
        made: the map. If it is a lidar's, all lengths of map, scans, motions and settings are in the map's unit (see
            `KeyframeMap.scale`).
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        runner: does the work, and times it.

    Raises:
        NotInMapError: no row of places was recognised, or too few scans along each recognised row lie on the map.
    """
    poses = se2.chain(motion.pose for motion in motions)
    setting = _Setting(TrackedRun.of(scans, poses), motions, made.keyframes, estimator, beam)
    table, rows, looked_up, ambiguous, conflicts = _LocalisedScans(len(scans), runner.progress), 0, 0, 0, 0
    for found_rows, submaps, ambiguous_submaps in _look_up(setting, made, table, runner):
        looked_up, ambiguous = looked_up + submaps, ambiguous + ambiguous_submaps
        for row in found_rows:
            with runner.time_stage("follow"):
                if _seed(setting, table, row):
                    rows += 1
                    conflicts += _follow_on(setting, table, row)
    if not rows:
        raise NotInMapError(*_say_what_was_tried(setting.drive, made, looked_up, ambiguous))
    with runner.time_stage("surety"):
        scale, samples = _measure_scale(setting, table, runner.engine)
    covariances = se2.scale_covariance(table.covariances, scale)
    covariances[-1] += _compute_effect_of_last_motion(motions, scans[-1])
    _fill_in(setting, table, covariances)
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
    )


def _look_up(
    setting: _Setting, made: KeyframeMap, table: _LocalisedScans, runner: Runner
) -> Iterator[tuple[list[list[Loop]], int, int]]:
    """Recognises places of the map in a recording, block by block; a block is a few successive submaps of the recording.

    Yields for each block (1) the rows of recognised places, (2) the number of submaps that were not part of the block
    before, and (3) how many of these fit several places about equally well. The last submaps of a block are part of the
    next block, too, so that a row across the border is found. A block is skipped if the central scans of all its new
    submaps were compared with the map already.

    Args:
        setting: the scans and the map.
        made: the map with its places.
        table: the poses of the scans; the caller may add poses between blocks.
        runner: does the work, and times it.
    """
    with runner.time_stage("recognise"):
        places = describe_map(made, setting.beam, runner.engine).places
        database = PlaceDatabase.of(MappedDrive.of(made.keyframes), places)
    nodes = pick_spaced(setting.drive.travelled, PLACE_SPACING_M)
    for begin in range(0, len(nodes), _BLOCK - ROW + 1):
        part = nodes[begin : begin + _BLOCK]
        fresh = part if begin == 0 else part[ROW - 1 :]
        if not table.tried[fresh].all():
            with runner.time_stage("recognise"):
                found = recognise(setting.drive, part, database, None, setting.estimator, setting.beam, runner.engine)
            yield found.rows, len(fresh), len(set(found.ambiguous) & set(fresh.tolist()))


def _seed(setting: _Setting, table: _LocalisedScans, row: Sequence[Loop]) -> bool:
    """Tracks the scans along a row of recognised places, and returns whether enough of these scans lie on the map.

    The table gets no new poses if one of the scans was tried before, if the registration of the row's middle scan does not
    converge, or if less than the share `_CONFIRMED` of the scans lies on the map.
    """
    first, last = row[0].later, row[-1].later
    if table.tried[first : last + 1].any():
        return False
    middle = row[len(row) // 2]
    expected = Registered(se2.compose(setting.keyframes.poses[middle.earlier], middle.pose), middle.covariance)
    registered = setting.register(MapAround(setting.keyframes, setting.beam), middle.later, expected)
    if registered.status is not PlaceStatus.CONVERGED:
        return False
    table.put(middle.later, registered)
    for way, limit in ((1, last), (-1, first)):
        _follow(setting, table, middle.later, way, limit)
    if table.on_map[first : last + 1].mean() >= _CONFIRMED:
        return True
    table.forget(slice(first, last + 1))
    return False


def _follow_on(setting: _Setting, table: _LocalisedScans, row: Sequence[Loop]) -> int:
    """Tracks scans onward from both ends of a row; returns the number of ends at which `_follow` returns True."""
    along = row[0].later + np.flatnonzero(table.on_map[row[0].later : row[-1].later + 1])
    ends = ((int(along[-1]), 1, len(table.tried) - 1), (int(along[0]), -1, 0))
    return sum(_follow(setting, table, start, way, limit) for start, way, limit in ends)


def _follow(setting: _Setting, table: _LocalisedScans, start: int, way: int, limit: int) -> bool:
    """Tracks scans up to `limit`, up to a scan that was tried before, or until `_GIVE_UP_M` of path hold no scan on the map.

    Scans after the last scan on the map stay marked as not tried, so that tracking from the other side can reach them.

    Args:
        setting: the scans and the map.
        table: the poses of the scans; the new poses are added to it.
        start: index of the first scan, which lies on the map.
        way: 1 tracks forward in time, -1 backward.
        limit: index of the last scan to track.

    Returns:
        Whether tracking reached a scan to which tracking from the other side gave a different pose.
    """
    around = MapAround(setting.keyframes, setting.beam)
    travelled = setting.drive.travelled
    known, last, lost = table.get(start), start, list[tuple[int, Registered]]()
    for k in range(start + way, limit + way, way):
        prediction = setting.predict(known, k - way, k)
        if table.tried[k]:
            return table.on_map[k] and is_away(se2.wrapped_between(prediction.pose, table.poses[k]), prediction)
        known = setting.register(around, k, prediction)
        lost.append((k, known))
        if known.status in ON_MAP:
            for number, one in lost:
                table.put(number, one)
            last, lost = k, []
        elif abs(travelled[k] - travelled[last]) > _GIVE_UP_M:
            break
    return False


def _measure_scale(setting: _Setting, table: _LocalisedScans, engine: Engine) -> tuple[NDArray[np.float64], int]:
    """Returns the factors (3,) by which psi's variances of x, y and yaw are too small, and the number of pairs of scans.

    With fewer than `FEWEST_PAIRS` pairs, the factors are not measured: each is `_USUAL_SCALE`.
    """
    travelled = setting.drive.travelled
    converged = np.array([status is PlaceStatus.CONVERGED for status in table.statuses], dtype=np.bool_)
    pairs = []
    for k in pick_spaced(travelled, _SAMPLE_M).tolist():
        n = int(np.searchsorted(travelled, travelled[k] + _APART_M))
        if n < len(travelled) and converged[k : n + 1].all() and travelled[n] - travelled[k] <= 2.0 * _APART_M:
            pairs.append([(scan, table.get(scan)) for scan in (k, n)])
    batches = [pairs[begin : begin + _BATCH] for begin in range(0, len(pairs), _BATCH)]
    squares = np.concatenate([np.empty((0, 3)), *engine.map(_compare, setting, batches)])
    return (np.full(3, _USUAL_SCALE) if len(squares) < FEWEST_PAIRS else find_usual_scale(squares)), len(squares)


def _compare(setting: _Setting, pairs: list[list[tuple[int, Registered]]]) -> NDArray[np.float64]:
    """Returns the squared differences (K, 3) in x, y, yaw of pairs of registrations, in units of psi's variances.

    Each pair holds the indices and poses of two scans. A pair is left out if one of its registrations does not converge.
    """
    even = np.arange(len(setting.keyframes)) % 2 == 0
    halves = [MapAround(setting.keyframes, setting.beam, chosen) for chosen in (even, ~even)]
    squares = []
    for pair in pairs:
        first, second = (
            setting.register(half, k, Registered(whole.pose, whole.covariance + LEAST_COVARIANCE))
            for half, (k, whole) in zip(halves, pair, strict=True)
        )
        if not first.status == second.status == PlaceStatus.CONVERGED:
            continue
        step = se2.between(*(setting.drive.poses[k] for k, _ in pair))
        off = se2.wrapped_between(se2.compose(first.pose, step), second.pose)
        back = se2.adjoint(se2.inverse(step))
        squares.append(off**2 / np.diag(back @ first.covariance @ back.T + second.covariance))
    return np.array(squares).reshape(-1, 3)


def _compute_effect_of_last_motion(motions: Sequence[Measurement], last: Scan) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) that the unknown motion through the last scan adds to its pose, in the pose's own frame.

    No later scan shows how the sensor moves while it takes the last scan, so that the motion before the scan is continued.
    Its error is taken from the usual change of the velocity between successive motions. The returns are displaced by this
    error times their times since the start of the scan, and the registered pose by half of the largest displacement.

    Args:
        motions: the motions between all successive scans.
        last: the last scan. If all its returns have one time, the result is zero.
    """
    lasts = np.array([motion.t1 - motion.t0 for motion in motions])
    changes = np.diff(se2.log([motion.pose for motion in motions]) / lasts[:, None], axis=0)
    if not len(changes) or not len(last.returns.times):
        return np.zeros((3, 3))
    half_s = 0.5 * float(np.ptp(last.returns.times))
    return np.asarray(half_s**2 * (changes.T @ changes) / len(changes))


def _fill_in(setting: _Setting, table: _LocalisedScans, covariances: NDArray[np.float64]) -> None:
    """Completes the table: stores scaled covariances (N, 3, 3), and fills in the scans that were not registered on the map.

    Their poses and covariances are predicted from the registered scan that is nearest along the path. Such a scan is OUTSIDE
    if no keyframe lies within `REACH_M` of its predicted pose, else LOST.
    """
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
                table.poses[k], table.covariances[k] = now.pose, now.covariance
    tree = cKDTree(setting.keyframes.poses[:, :2])
    for k in np.flatnonzero(~known).tolist():
        is_outside = tree.query(table.poses[k, :2])[0] > REACH_M
        table.statuses[k] = PlaceStatus.OUTSIDE if is_outside else PlaceStatus.LOST


def _say_what_was_tried(drive: TrackedRun, made: KeyframeMap, looked_up: int, ambiguous: int) -> tuple[str, str]:
    """Returns two texts: why a recording was not found in a map, with what was tried, and what the user can do.

    `looked_up` and `ambiguous` are the numbers of submaps in `Localised`.
    """
    unit_m = made.keyframes.unit_m or 1.0
    path_m = float(drive.travelled[-1]) * unit_m
    if looked_up < ROW:
        too_short = (
            f"not found in this map: its path of {path_m:.0f} m is too short, as {ROW} places that are "
            f"{PLACE_SPACING_M * unit_m:g} m apart must be recognised in a row"
        )
        return too_short, _LONGER
    along, places = f"submaps along {path_m:.0f} m of path", count_of(len(made.places.keyframes), "place")
    if 2 * ambiguous > looked_up:
        fit = f"{ambiguous} of {looked_up} {along} fit more than one of {places} about equally well"
        return f"several places of this map fit, and nothing shows which place is the right one ({fit})", _LONGER
    fits = f"; {ambiguous} of the submaps fit several places about equally well" if ambiguous else ""
    remedy = _LARGER_MAP if len(made.places.keyframes) < 2 * ROW else _OTHER_MAP  # few places hardly ever form a row
    return (
        f"not in this map: no {ROW} successive places of it were recognised and confirmed by the scans between them "
        f"({looked_up} {along} were compared with {places}{fits})",
        remedy,
    )
