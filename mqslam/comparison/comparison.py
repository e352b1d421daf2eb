"""Compares rows (front ends or given trajectories) on the same scans, and finds the best row and how far rows differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mqslam.auditing.sweeps import count_interpolated, find_covered
from mqslam.backend.loops import passes
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.refinement import SAMPLE_M, find_crossings, measure_psi_across
from mqslam.comparison.best import Best, Standing, find_best
from mqslam.comparison.judgement import (
    Judge,
    JudgedRow,
    Place,
    compare_pairs,
    find_places,
    pick_stations,
    take_common_scans,
)
from mqslam.comparison.rows import Row
from mqslam.config import Config
from mqslam.core import units
from mqslam.core.engine import Engine
from mqslam.core.recording import Recording
from mqslam.core.scans import Scans
from mqslam.errors import EstimationError
from mqslam.evaluation import Evaluation
from mqslam.execution.progress import Progress
from mqslam.psi.place import Beam, beam_of


@dataclass(frozen=True, slots=True)
class Comparison:
    """The result of a comparison.

    Args:
        recording: the recording.
        settings: all settings.
        doppler_beta: range shift per closing speed [s], with which the map of each row was rendered.
        rows: front ends and given trajectories, including those that failed.
        judged: judgements of the rows that ran, by the rows' names.
        best: the best row, or the rows between which nothing decides; None without two rows to compare.
        psi_across: psi per point across passes, by the rows' names, at the places that the best row passes twice.
        covered: number of scans that the trajectory of each row covers, by the rows' names.
        interpolated: number of these scans near which the trajectory of each row has no pose, by the rows' names.
        compared: number of scans that every row covers, on which the rows are judged.
        places: places where the rows differ most. `JudgedRow.crops` begins with the crops at these places.
        stations: places spread evenly over time. The crops at these places come next in `JudgedRow.crops`.
        agreement: for each pair of rows that ran, both names, and the errors of the first row against the second row.
        warnings: warnings that a reader of the figures must know.
    """

    recording: Recording
    settings: Config
    doppler_beta: float
    rows: tuple[Row, ...]
    judged: dict[str, JudgedRow]
    best: Best | None
    psi_across: dict[str, float]
    covered: dict[str, int]
    interpolated: dict[str, int]
    compared: int
    places: tuple[Place, ...]
    stations: tuple[Place, ...]
    agreement: tuple[tuple[str, str, Evaluation], ...]
    warnings: tuple[str, ...]


def compare_rows(
    recording: Recording,
    rows: Sequence[Row],
    scans: Scans,
    settings: Config,
    warnings: Sequence[str],
    engine: Engine,
    progress: Progress,
) -> Comparison:
    """Judges rows on the scans that all of them cover, and finds the best.

    Args:
        recording: the recording.
        rows: front ends and given trajectories, including those that failed.
        scans: scans of the recording.
        settings: all settings, with the Doppler shift by which the scans are rendered.
        warnings: warnings about faults of the data, and about data that are not used.
        engine: where the rows are judged; the result does not depend on it.
        progress: called as the audits go on.

    Raises:
        EstimationError: no row ran, or the rows share too few scans.
    """
    ran = [row for row in rows if row.trajectory is not None]
    if not ran:
        raise EstimationError("; ".join(f"{row.name}: {row.failure}" for row in rows))
    common, beta = take_common_scans(ran, scans), settings.sensor.doppler_beta or 0.0
    beam = beam_of(settings.estimator, beta)
    tracks = {row.name: row.trajectory for row in ran if row.trajectory is not None}
    places = find_places(common, list(tracks.values()))
    stations = pick_stations(common)
    covered = {name: find_covered(scans, track) for name, track in tracks.items()}
    judge = Judge(common, recording.ground_truth, [*places, *stations], settings, beam, engine, progress)
    shown, judged = judge.judge_all(rows)
    best = find_best([Standing.of(row) for row in judged.values()])
    return Comparison(
        recording=recording,
        settings=settings,
        doppler_beta=beta,
        rows=tuple(shown),
        judged=judged,
        best=best,
        psi_across=measure_rows_across(judged, best, common, settings, beam, engine),
        covered={name: len(inside) for name, inside in covered.items()},
        interpolated={name: count_interpolated(scans, tracks[name], inside) for name, inside in covered.items()},
        compared=len(common),
        places=tuple(places),
        stations=tuple(stations),
        agreement=tuple(compare_pairs(ran)),
        warnings=(
            *(f"{row.name} failed: {row.failure}" for row in shown if row.failure is not None),
            *warnings,
            *(f"{row.name}: {warning}" for row in shown for warning in row.warnings),
        ),
    )


def measure_rows_across(
    judged: Mapping[str, JudgedRow], best: Best | None, scans: Scans, settings: Config, beam: Beam, engine: Engine
) -> dict[str, float]:
    """Measures psi across passes of each row: psi per point of later passes' returns among the returns of earlier passes.

    psi of different places cannot be compared, so all rows are measured at the same places: where the best row passes a
    place twice. If several rows may be the best, the places of the first of these rows are taken.

    Args:
        judged: judgements of the rows, by the rows' names.
        best: the best row, or the rows between which nothing decides; None for one row alone.
        scans: scans that every row covers.
        settings: all settings.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.

    Returns:
        psi per point, by the rows' names; empty if the best row passes no place twice.
    """
    poses = {name: row.trajectory.at(scans.stamps_us) for name, row in judged.items()}
    if not poses:
        return {}
    factor = 1.0 / (scans.unit_m or 1.0)  # so that lengths in metres hold for a lidar in a room as for a radar in a street
    poses = {name: units.scale_pose(own, factor) for name, own in poses.items()}
    estimator = units.scale_settings(settings, factor).estimator
    beam = beam_of(estimator, beam.doppler_beta)
    drive = TrackedRun.of(scans.scale_ranges(factor), poses[best.rows[0] if best else next(iter(poses))])
    crossings = find_crossings(drive, SAMPLE_M, passes.LEAST_PATH_M)
    across = {
        name: measure_psi_across(replace(drive, poses=own), crossings, estimator, beam, engine)
        for name, own in poses.items()
    }
    return {name: psi for name, psi in across.items() if psi is not None}
