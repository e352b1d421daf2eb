"""Judges every row of a comparison in the same way, with ground truth and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.judge import Audit, audit
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.sweeps import Sweeps, find_covered, place_sweeps
from mqslam.auditing.windows.inflation import centre_window
from mqslam.comparison.rows import Row
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.point_map import PointMap, pick_thinned
from mqslam.core.scans import Scans
from mqslam.core.statistics import pick_evenly
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, explain_rest, is_or_are
from mqslam.errors import EstimationError, tolerate
from mqslam.evaluation import SLACK_US, Evaluation, evaluate, measure_nees
from mqslam.execution.progress import Progress
from mqslam.mapping.render import render
from mqslam.psi.place import Beam

# At least this many windows lie between two of the places that are shown because the trajectories differ there.
_PLACES_APART = 2
# Number of places shown at which the trajectories differ most.
_PLACES = 6
# A difference in yaw counts as the distance by which it moves a point this far away [m], in the unit of the scans.
_LEVER_M = 20.0

# These affect what the report shows, but no result.
_STATIONS: Final = 60  # places along the path that the report shows
_MAP_POINTS: Final = 60_000  # points of a row's map that the report shows
_CROP_M: Final = 60.0  # half side of a crop [m], in the unit of the scans


@dataclass(frozen=True, slots=True)
class Place:
    """A place at which the rows can be compared by eye: a window of scans.

    Args:
        begin, end: the window holds the scans with indices begin <= k < end among the scans that all rows cover.
        t0, t1: times at which the window begins and ends [s] since the recording's start.
        apart_m: largest difference between two rows' motions through the window [m]: the root of the sum of the squares
            of the difference in position and of `_LEVER_M` times the difference in yaw. Zero for places of `pick_stations`.
    """

    begin: int
    end: int
    t0: float
    t1: float
    apart_m: float


@dataclass(frozen=True)
class JudgedRow:
    """A row of a comparison with its map, the audit of this map, and the row's errors against ground truth.

    Args:
        row: the row.
        psi_per_point: score per point of its rendered map; None without points.
        matched: share of the map's points with a neighbour from another scan; None without points.
        audit: audit of its map.
        before, after: errors against ground truth before and after the back end; None without enough ground truth.
        nees: mean squared error of its motions in units of their covariances, per degree of freedom: 1 on average if the
            covariances are right. None if it cannot be computed, for example without ground truth or motions.
        crops: for each place, points (M, 2) [m] of its window, in the frame of the sensor at the window's middle scan.
        map: part of the points of the rendered map, evenly spread.
    """

    row: Row
    psi_per_point: float | None
    matched: float | None
    audit: Audit
    before: Evaluation | None
    after: Evaluation | None
    nees: float | None
    crops: tuple[NDArray[np.float64], ...]
    map: PointMap

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory that was judged; a row without a trajectory cannot be judged."""
        assert self.row.trajectory is not None
        return self.row.trajectory


def take_common_scans(rows: Sequence[Row], scans: Scans, left_out: int = 0) -> Scans:
    """Returns the scans that the trajectory of every row covers.

    Args:
        rows: rows of a comparison; rows without a trajectory are ignored.
        scans: scans of the recording.
        left_out: number of scans that are left out because the sensor had hardly moved.

    Raises:
        EstimationError: fewer scans are covered by all rows than a window takes.
    """
    by_row = {row.name: find_covered(scans, row.trajectory) for row in rows if row.trajectory is not None}
    inside = set(range(len(scans))).intersection(*by_row.values())
    if len(scans) < WINDOW:
        too_few = f"{count_of(len(scans), 'scan')} {is_or_are(len(scans))} too few for a comparison"
        rest = explain_rest(len(scans), left_out, WINDOW) or [f"give a recording of at least {WINDOW} scans"]
        raise EstimationError(too_few, *rest)
    if len(inside) < WINDOW:
        each = ", ".join(f"{name} covers {len(covered)}" for name, covered in by_row.items())
        raise EstimationError(
            f"the rows share {len(inside)} of {count_of(len(scans), 'scan')} ({each}), and {WINDOW} are needed; "
            "leave out the rows that cover too few scans"
        )
    return scans.take(sorted(inside))


def find_places(scans: Scans, tracks: Sequence[Trajectory]) -> list[Place]:
    """Finds the windows over which the motions of the trajectories differ most; the largest difference comes first.

    There are at most `_PLACES` windows, and at least `_PLACES_APART` other windows lie between two of them.

    Args:
        scans: scans that every trajectory covers.
        tracks: the trajectories; fewer than two give no places.
    """
    stamps = scans.stamps_us
    begins = np.arange(0, len(scans) - WINDOW + 1, WINDOW)
    if len(tracks) < 2 or not len(begins):
        return []
    through = []
    for track in tracks:
        poses = track.at(stamps)
        through.append(se2.wrapped_between(poses[begins], poses[begins + WINDOW - 1]))
    apart, lever_m = np.zeros(len(begins)), _LEVER_M * (scans.unit_m or 1.0)
    for a, b in combinations(through, 2):
        off = se2.subtract(a, b)
        apart = np.maximum(apart, np.hypot(np.hypot(off[:, 0], off[:, 1]), lever_m * off[:, 2]))
    chosen: list[int] = []
    for k in np.argsort(-apart, kind="stable").tolist():
        if all(abs(k - other) > _PLACES_APART for other in chosen):
            chosen.append(k)
        if len(chosen) == _PLACES:
            break
    spans = [(int(begins[k]), int(begins[k]) + WINDOW, float(apart[k])) for k in chosen]
    return [Place(a, b, scans[a].t0, scans[b - 1].t1, off) for a, b, off in spans]


def pick_stations(scans: Scans) -> list[Place]:
    """Returns places evenly spread over time, each a window of `WINDOW` scans, whether the rows differ there or not."""
    begins = np.arange(0, len(scans) - WINDOW + 1, WINDOW)
    chosen = begins[pick_evenly(len(begins), _STATIONS)]
    return [Place(k, k + WINDOW, scans[k].t0, scans[k + WINDOW - 1].t1, 0.0) for k in chosen.tolist()]


@dataclass(frozen=True)
class Judge:
    """The data and settings by which every row of a comparison is judged.

    Args:
        scans: scans that every row covers.
        truth: ground truth, or None.
        where: places at which each row's map is cropped.
        settings: all settings.
        beam: the sensor's errors.
        engine: where rows are judged; the result does not depend on it.
        progress: called as the audits go on, with stages such as `audit: psi`, which name the row.
    """

    scans: Scans
    truth: Trajectory | None
    where: Sequence[Place]
    settings: Config
    beam: Beam
    engine: Engine
    progress: Progress

    def judge_all(self, rows: Sequence[Row]) -> tuple[list[Row], dict[str, JudgedRow]]:
        """Judges every row that has a trajectory.

        Errors against ground truth are measured from the first common scan to the last one, so that all rows are judged on
        the same part of the drive.

        Returns:
            All rows, with a failure in each row that could not be judged, and the judgements of the judged rows by name.
        """
        judged: dict[str, JudgedRow] = {}
        shown = []
        cut = replace(self, truth=None if self.truth is None else _cut_to_scans(self.truth, self.scans))
        for row in rows:
            failure: list[str] = []
            if row.trajectory is not None:
                with tolerate("the judgement of its map", failure):
                    judged[row.name] = cut.judge(row)
            shown.append(replace(row, failure=failure[0]) if failure else row)
        return shown, judged

    def judge(self, row: Row) -> JudgedRow:
        """Judges a row that has a trajectory; without ground truth, the errors and the NEES are None."""
        assert row.trajectory is not None and row.odometry is not None
        scans, truth, beam, engine = self.scans, self.truth, self.beam, self.engine

        def show(stage: str, done: int, total: int) -> None:
            self.progress(f"{stage}: {row.name}", done, total)

        sweeps, _ = place_sweeps(scans, row.trajectory, beam)
        rendered = render(scans, sweeps.poses, self.settings.estimator, beam, engine)
        return JudgedRow(
            row=row,
            map=rendered.take(pick_thinned(rendered.points, _MAP_POINTS)),
            psi_per_point=rendered.psi_per_point,
            matched=rendered.matched_share,
            audit=audit(sweeps, self.settings, engine, show),
            before=None if truth is None else evaluate(row.odometry, truth),
            after=None if truth is None else evaluate(row.trajectory, truth),
            nees=None if truth is None else measure_nees(row.measurements, truth, scans.start_us),
            crops=tuple(_crop(sweeps, place, _CROP_M * (scans.unit_m or 1.0)) for place in self.where),
        )


def _cut_to_scans(truth: Trajectory, scans: Scans) -> Trajectory | None:
    """Returns the ground truth from the start of the first scan to the end of the last one; None without poses there."""
    begin, end = (scans.start_us + round(1e6 * time_s) for time_s in (scans[0].t0, scans[-1].t1))
    inside = (truth.stamps_us >= begin - SLACK_US) & (truth.stamps_us <= end + SLACK_US)
    return Trajectory(truth.stamps_us[inside], truth.poses[inside]) if inside.any() else None


def _crop(sweeps: Sweeps, place: Place, half_m: float) -> NDArray[np.float64]:
    """Returns the points (M, 2) [m] of a place that lie in a square around the sensor, whose sides are 2 `half_m` [m] long.

    The points are in the frame of the sensor at the window's middle scan.
    """
    points = centre_window(sweeps, place.begin, place.end)[0].points
    return np.asarray(points[np.abs(points).max(axis=1) <= half_m])


def compare_pairs(rows: Sequence[Row]) -> list[tuple[str, str, Evaluation]]:
    """Returns for each pair of rows both names, and the errors of the first row if the second row is taken as the truth.

    A pair is left out if fewer than 3 stamps of the second row lie in the time span of the first row.
    """
    pairs = []
    for a, b in combinations(rows, 2):
        assert a.trajectory is not None and b.trajectory is not None
        errors = evaluate(a.trajectory, b.trajectory)
        if errors is not None:
            pairs.append((a.name, b.name, errors))
    return pairs
