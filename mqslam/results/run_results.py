"""What a run leaves in its folder."""

from __future__ import annotations

import csv
import io
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from mqslam.backend.pose_graph import PoseCovariances, PoseGraph, marginals
from mqslam.config import dump_yaml
from mqslam.core.evenly import evenly
from mqslam.core.measurement import Measurement
from mqslam.core.point_map import write_ply
from mqslam.core.recording import Recording
from mqslam.core.trajectory import write_tum
from mqslam.errors import OutputError, tolerate
from mqslam.execution.checkpoint import FOLDER
from mqslam.execution.files import write_json, write_text
from mqslam.mapping.occupancy_grid import write_nav2_map
from mqslam.report import Report, WindowScores, write_report
from mqslam.slam import Run

_COLUMNS = [
    "t0", "t1", "dx", "dy", "dyaw", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw",
    "psi", "psi_odometry", "points", "matched", "status",
]  # fmt: skip


_ELLIPSES = 150  # poses whose covariance the report shows


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder aside that takes the place of `out` when the block ends without an error.

    Its name is always the same, so that what a killed run leaves there is cleared by the next one.

    Raises:
        OutputError: it cannot be written.
    """
    aside, replaced = out.parent / f".{out.name}.unfinished", out.parent / f".{out.name}.replaced"
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(replaced, ignore_errors=True)
    try:
        aside.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made ({error.strerror}); choose another --out") from error
    try:
        yield aside
        if out.exists():
            out.rename(replaced)
        aside.rename(out)
        shutil.rmtree(replaced, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}); free space or choose another --out") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def check_free(out: Path, *, force: bool, resume: bool = False, recording: Path | None = None) -> None:
    """See that a folder may be written before hours are spent on what goes into it.

    Args:
        out: the folder.
        force: whether what it holds may be replaced.
        resume: whether an unfinished run in it is to be continued.
        recording: what the result is computed from, which must not be replaced by it.

    Raises:
        OutputError: it exists with content and neither is given, holds the recording, is a file or cannot be made.
    """
    if out.name in ("", ".."):
        raise OutputError(f"{out}: is no name of a new folder; choose another --out")
    unfinished = (out / FOLDER).is_dir()
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not force and not (resume and unfinished)):
        how = "--resume to continue the unfinished run in it" if unfinished else "--force to replace it"
        raise OutputError(f"{out}: exists already; choose another --out or give {how}")
    if recording is not None and recording.resolve().is_relative_to(out.resolve()):
        raise OutputError(f"{out}: holds the recording; choose another --out")
    if recording is not None and recording.is_dir() and out.resolve().is_relative_to(recording.resolve()):
        raise OutputError(f"{out}: lies in the recording; choose another --out")
    check_writable(out, "--out")


def check_writable(out: Path, option: str) -> None:
    """See that the folder nearest above what is to be made may be written to.

    Args:
        out: what is to be made.
        option: what an error calls it.

    Raises:
        OutputError: it may not.
    """
    above = next(folder for folder in out.absolute().parents if folder.exists())
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise OutputError(f"{out}: cannot be made ({above} is no folder to write to); choose another {option}")


def write_run(folder: Path, run: Run, recording: Recording, summary: dict[str, Any], notes: Sequence[str]) -> None:
    """Write every result file of a run into an existing folder, those first that are worth the most.

    Map, graph and report may fail, by a fault of theirs or of a library or for want of memory: that is a warning then, and
    all others are written. The warning is added to those of the summary.

    Args:
        folder: where to.
        run: what there is to write.
        recording: the recording it was made from.
        summary: content of summary.json, with its warnings.
        notes: what a user should know about how the recording was understood, for run.log.

    Raises:
        OutputError: a file cannot be written.
    """
    warnings: list[str] = summary["warnings"]
    settings = dump_yaml(run.config)
    write_tum(folder / "trajectory.tum", run.optimised)
    write_tum(folder / "odometry.tum", run.odometry)
    write_text(folder / "measurements.csv", measurements_csv(run.measurements))
    write_text(folder / "config.yaml", settings)
    _write_numbers(folder, summary, notes)
    before = len(warnings)
    with tolerate("graph.g2o", warnings):
        write_text(folder / "graph.g2o", g2o(run.graph, run.values))
    with tolerate("map.ply", warnings):
        write_ply(folder / "map.ply", run.map_optimised)
    with tolerate("map.pgm", warnings):
        write_nav2_map(folder, run.map_optimised, run.config.map.cell_m)
    with tolerate("report.html", warnings):
        sure = marginals(run.graph, run.values, evenly(run.graph.size, _ELLIPSES).tolist())
        if sure.failure is not None:
            warnings.append(f"the covariances of the poses are not known ({sure.failure}): the report shows no ellipses")
        warnings += write_report(folder / "report.html", _report(run, recording, summary, sure, settings))
    if len(warnings) > before:
        _write_numbers(folder, summary, notes)


def _write_numbers(folder: Path, summary: dict[str, Any], notes: Sequence[str]) -> None:
    """Write the files that hold the warnings."""
    write_text(folder / "run.log", log_text(summary, notes))
    write_json(folder / "summary.json", summary)


def _report(run: Run, recording: Recording, summary: dict[str, Any], sure: PoseCovariances, settings: str) -> Report:
    """A run as its report shows it."""
    return Report(
        title=recording.path.resolve().name,
        summary=summary,
        odometry=run.odometry,
        optimised=run.optimised,
        ground_truth=recording.ground_truth,
        map_odometry=run.map_odometry,
        map_optimised=run.map_optimised,
        windows=window_scores(run.measurements),
        before=run.before,
        checks=tuple(run.checks),
        settings=run.config.audit,
        loops=np.array([(loop.earlier, loop.later) for loop in run.loops], dtype=np.int64).reshape(-1, 2),
        sure=sure,
        warnings=tuple(summary["warnings"]),
        settings_yaml=settings,
    )


def log_text(summary: dict[str, Any], notes: Sequence[str]) -> str:
    """The lines of run.log."""
    dataset = summary["dataset"]
    lines = [f"mqslam {summary['mqslam_version']} on {dataset['path']} ({dataset['format']})"]
    lines += [f"note: {note}" for note in notes] + [f"warning: {warning}" for warning in summary["warnings"]]
    lines.append(f"Doppler shift: {summary['doppler_beta']:.4f} s of range per closing speed")
    lines += [f"{stage}: {seconds:.2f} s" for stage, seconds in summary["runtime_s"].items()]
    lines.append(f"verdict: {summary['verdict']['status']}: {'; '.join(summary['verdict']['reasons'])}")
    return "\n".join(lines) + "\n"


def measurements_csv(measurements: Sequence[Measurement]) -> str:
    """One row per measurement; covariance of dx [m], dy [m], dyaw [rad] in the frame of the pose at t0."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for m in measurements:
        upper = m.covariance[np.triu_indices(3)]
        numbers = [*m.pose, *upper, m.psi, m.psi_odometry]
        rows.writerow(
            [f"{m.t0:.6f}", f"{m.t1:.6f}", *(f"{n:.9g}" for n in numbers), m.points, f"{m.matched:.4f}", m.status.value]
        )
    return text.getvalue()


def window_scores(measurements: Sequence[Measurement]) -> WindowScores:
    """The measurements as the report plots them."""
    return WindowScores(
        t0=np.array([m.t0 for m in measurements]),
        t1=np.array([m.t1 for m in measurements]),
        psi_minimum=np.array([m.psi for m in measurements]),
        psi_odometry=np.array([m.psi_odometry for m in measurements]),
        points=np.array([m.points for m in measurements], dtype=np.int64),
        matched=np.array([m.matched for m in measurements]),
        status=tuple(m.status.value for m in measurements),
    )


def g2o(graph: PoseGraph, values: gtsam.Values) -> str:
    """The graph in g2o's text form; GTSAM's own writer takes no robust noise, so the Gaussian under it is written."""
    lines = []
    for k in range(graph.size):
        pose = values.atPose2(gtsam.symbol("x", k))
        lines.append(f"VERTEX_SE2 {k} {pose.x():.9g} {pose.y():.9g} {pose.theta():.9g}")
    for i in range(graph.factors.size()):
        factor = graph.factors.at(i)
        if not isinstance(factor, gtsam.BetweenFactorPose2):
            continue
        a, b = (gtsam.Symbol(key).index() for key in factor.keys())
        z = factor.measured()
        robust = factor.noiseModel()
        assert isinstance(robust, gtsam.noiseModel.Robust)
        gaussian = robust.noise()
        assert isinstance(gaussian, gtsam.noiseModel.Gaussian)
        upper = " ".join(f"{v:.9g}" for v in gaussian.information()[np.triu_indices(3)])
        lines.append(f"EDGE_SE2 {a} {b} {z.x():.9g} {z.y():.9g} {z.theta():.9g} {upper}")
    return "\n".join(lines) + "\n"
