"""The judges of a comparison: the same for every row, with ground truth and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.inflation import middled
from mqslam.audit.judge import Audit, audit
from mqslam.audit.sweeps import Sweeps, covered, swept
from mqslam.compare.rows import Row
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.evenly import evenly
from mqslam.core.point_map import PointMap, thinned
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError, tolerate
from mqslam.evaluation import Evaluation, evaluate
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.mapping.render import render
from mqslam.psi.place import Beam

STATIONS = 60  # that can be looked at
PLACES = 6  # that are shown, where the rows differ most
_LEVER_M = 20.0  # a turn counts as what it moves at this distance [m]
_MAP_POINTS = 60_000  # of a row's map that are kept to be looked at
_CROP_M = 60.0  # half side of a crop [m]


@dataclass(frozen=True, slots=True)
class Place:
    """A place where the rows differ.

    Args:
        begin, end: its sweeps among those that all rows cover.
        t0, t1: when it begins and ends [s] since the recording's start.
        apart_m: how far the two rows farthest apart are from each other on the way through it [m].
    """

    begin: int
    end: int
    t0: float
    t1: float
    apart_m: float


@dataclass(frozen=True)
class Judged:
    """A row and what the judges say.

    Args:
        row: the row.
        psi_per_point: score of its rendered map per point.
        matched: share of the map's points that another sweep saw too.
        audit: its windows and revisits judged.
        before, after: errors against ground truth before and after the back end, or None without ground truth.
        crops: (M, 2) [m] points of each place's window, in the frame of the sensor at its middle.
        map: part of the rendered map, spread evenly.
    """

    row: Row
    psi_per_point: float | None
    matched: float | None
    audit: Audit
    before: Evaluation | None
    after: Evaluation | None
    crops: tuple[NDArray[np.float64], ...]
    map: PointMap


def enough_in_common(rows: Sequence[Row], scans: Scans, fewest: int) -> Scans:
    """The scans that the trajectory of every row covers.

    Raises:
        EstimationError: they are fewer than `fewest`.
    """
    by_row = {row.name: covered(scans, row.trajectory) for row in rows if row.trajectory is not None}
    inside = set(range(len(scans))).intersection(*by_row.values())
    if len(scans) < fewest:
        raise EstimationError(f"{len(scans)} revolutions are too few to compare on; {fewest} at least are needed")
    if len(inside) < fewest:
        said = ", ".join(f"{name} covers {len(its)}" for name, its in by_row.items())
        raise EstimationError(f"the rows share {len(inside)} of {len(scans)} revolutions ({said}); leave some out")
    return scans.take(sorted(inside))


def places(scans: Scans, tracks: Sequence[Trajectory], size: int) -> list[Place]:
    """Where the trajectories differ most on the way through a window, the worst first, each well away from the others."""
    stamps = scans.stamps_us
    begins = np.arange(0, len(scans) - size + 1, size)
    if len(tracks) < 2 or not len(begins):
        return []
    through = []
    for track in tracks:
        poses = track.at(stamps)
        through.append(se2.wrapped_between(poses[begins], poses[begins + size - 1]))
    apart = np.zeros(len(begins))
    for i, a in enumerate(through):
        for b in through[i + 1 :]:
            off = a - b
            apart = np.maximum(apart, np.hypot(np.hypot(off[:, 0], off[:, 1]), _LEVER_M * se2.wrap(off[:, 2])))
    chosen: list[int] = []
    for k in np.argsort(-apart, kind="stable").tolist():
        if all(abs(k - other) > 2 for other in chosen):
            chosen.append(k)
        if len(chosen) == PLACES:
            break
    spans = [(int(begins[k]), int(begins[k]) + size, float(apart[k])) for k in chosen]
    return [Place(a, b, scans[a].t0, scans[b - 1].t1, off) for a, b, off in spans]


def stations(scans: Scans, size: int) -> list[Place]:
    """Places evenly spread along the way, whatever the rows make of them."""
    begins = np.arange(0, len(scans) - size + 1, size)
    chosen = begins[evenly(len(begins), STATIONS)]
    return [Place(k, k + size, scans[k].t0, scans[k + size - 1].t1, 0.0) for k in chosen.tolist()]


def judge_rows(
    rows: Sequence[Row],
    scans: Scans,
    truth: Trajectory | None,
    where: Sequence[Place],
    config: Config,
    beam: Beam,
    engine: Engine,
    progress: Progress,
) -> tuple[list[Row], dict[str, Judged]]:
    """Judge every row that has a trajectory, as `judge` does.

    Returns:
        the rows, with a failure where the judges could make nothing of one, and what they say of the others by name.
    """
    judged: dict[str, Judged] = {}
    shown = []
    for row in rows:
        failure: list[str] = []
        if row.trajectory is not None:
            with tolerate("the judgement of its map", failure):
                judged[row.name] = judge(row, scans, truth, where, config, beam, engine, progress)
        shown.append(replace(row, failure=failure[0]) if failure else row)
    return shown, judged


def judge(
    row: Row,
    scans: Scans,
    truth: Trajectory | None,
    where: Sequence[Place],
    config: Config,
    beam: Beam,
    engine: Engine,
    progress: Progress,
) -> Judged:
    """Judge one row.

    Args:
        row: with a trajectory.
        scans: those that every row covers.
        truth: ground truth, or None.
        where: the places to crop.
        config: all settings.
        beam: the sensor's errors.
        engine: where it is judged; the result does not depend on it.
        progress: called as the audit goes on.
    """
    assert row.trajectory is not None and row.odometry is not None
    sweeps, _ = swept(scans, row.trajectory, beam)
    rendered = render(scans, sweeps.poses, config.map, config.estimator, beam, engine)
    return Judged(
        row=row,
        map=rendered.take(thinned(rendered.points, _MAP_POINTS)),
        psi_per_point=rendered.psi_per_point,
        matched=rendered.matched_share,
        audit=audit(sweeps, config.audit, config.estimator, config.loops, config.verdict, engine, progress),
        before=None if truth is None else evaluate(row.odometry, truth),
        after=None if truth is None else evaluate(row.trajectory, truth),
        crops=tuple(_crop(sweeps, place) for place in where),
    )


def _crop(sweeps: Sweeps, place: Place) -> NDArray[np.float64]:
    points = middled(sweeps, place.begin, place.end)[0].points
    return np.asarray(points[np.abs(points).max(axis=1) <= _CROP_M])


def agreement(rows: Sequence[Row]) -> list[tuple[str, str, Evaluation]]:
    """How far every two rows are apart: the first judged as if the second were the truth."""
    found = []
    for i, a in enumerate(rows):
        for b in rows[i + 1 :]:
            assert a.trajectory is not None and b.trajectory is not None
            errors = evaluate(a.trajectory, b.trajectory)
            if errors is not None:
                found.append((a.name, b.name, errors))
    return found
