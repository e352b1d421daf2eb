"""The rows of an audit's tables: what `audit.json` and the CSV files say of every window, step, span and revisit."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import WindowAudit


class WindowRow(TypedDict):
    """A row of audit.csv; lengths in metres, angles in radians, times in seconds since the recording began."""

    t0: float
    t1: float
    x: float
    y: float
    yaw: float
    torn: bool | None
    undecided: str | None
    inflation: float
    p_value: float | None
    dx: float
    dy: float
    dyaw: float
    sigma_x: float
    sigma_y: float
    sigma_yaw: float
    dv: float
    domega: float
    size_m: float
    psi_per_point: float
    psi_per_point_best: float
    matched: float
    matched_best: float
    points: int
    speed_error: float | None
    map_entropy: float
    plane_variance: float
    joint_entropy: float
    grid_entropy: float


class RevisitRow(TypedDict):
    """A row of revisits.csv, in the units of the others."""

    t_earlier: float
    t_later: float
    x: float
    y: float
    yaw: float
    torn: bool | None
    sure: bool
    dx: float
    dy: float
    dyaw: float
    sigma_x: float
    sigma_y: float
    sigma_yaw: float
    claimed_sigma_x: float | None
    claimed_sigma_y: float | None
    claimed_sigma_yaw: float | None
    inflation: float
    p_value: float | None
    matched: float
    psi_per_point: float
    psi_per_point_best: float


class StepRow(TypedDict):
    """A row of steps.csv."""

    t: float
    x: float
    y: float
    yaw: float
    dx: float
    dy: float
    dyaw: float
    size_m: float
    matched: float
    p_value: float | None
    torn: bool | None


class SpanRow(TypedDict):
    """A row of spans.csv."""

    t_earlier: float
    t_later: float
    x: float
    y: float
    yaw: float
    path_m: float
    dx: float
    dy: float
    dyaw: float
    matched: float
    p_value: float | None
    torn: bool | None


def list_window(window: WindowAudit) -> WindowRow:
    """Returns the row of a window."""
    bend, beside = window.bend, window.measures
    span = window.t1 - window.t0
    sigma = np.sqrt(np.diag(bend.covariance))
    return {
        "t0": window.t0,
        "t1": window.t1,
        "x": float(window.pose[0]),
        "y": float(window.pose[1]),
        "yaw": float(window.pose[2]),
        "torn": window.torn if window.undecided is None else None,
        "undecided": window.undecided,
        "inflation": bend.inflation,
        "p_value": _known(window.p_value),
        "dx": float(bend.correction[0]),
        "dy": float(bend.correction[1]),
        "dyaw": float(bend.correction[2]),
        "sigma_x": float(sigma[0]),
        "sigma_y": float(sigma[1]),
        "sigma_yaw": float(sigma[2]),
        "dv": float(bend.correction[0] / span),
        "domega": float(bend.correction[2] / span),
        "size_m": bend.size_m,
        "psi_per_point": bend.psi,
        "psi_per_point_best": bend.psi_best,
        "matched": bend.matched,
        "matched_best": bend.matched_best,
        "points": bend.points,
        "speed_error": window.speed.error_mps if window.speed is not None and window.speed.sure else None,
        "map_entropy": beside.map_entropy,
        "plane_variance": beside.plane_variance,
        "joint_entropy": beside.joint_entropy,
        "grid_entropy": beside.grid_entropy,
    }


def list_revisit(judged: RevisitAudit, sweeps: Sweeps) -> RevisitRow:
    """Returns the row of a revisit."""
    revisit = judged.revisit
    pose, sigma = sweeps.poses[revisit.later], np.sqrt(np.diag(revisit.covariance))
    claimed = None if judged.stated_covariance is None else np.sqrt(np.diag(judged.stated_covariance))
    return {
        "t_earlier": float(sweeps.times[revisit.earlier]),
        "t_later": float(sweeps.times[revisit.later]),
        "x": float(pose[0]),
        "y": float(pose[1]),
        "yaw": float(pose[2]),
        "torn": judged.torn if revisit.sure else None,
        "sure": revisit.sure,
        "dx": float(revisit.offset[0]),
        "dy": float(revisit.offset[1]),
        "dyaw": float(revisit.offset[2]),
        "sigma_x": float(sigma[0]),
        "sigma_y": float(sigma[1]),
        "sigma_yaw": float(sigma[2]),
        "claimed_sigma_x": None if claimed is None else float(claimed[0]),
        "claimed_sigma_y": None if claimed is None else float(claimed[1]),
        "claimed_sigma_yaw": None if claimed is None else float(claimed[2]),
        "inflation": revisit.inflation,
        "p_value": _known(judged.p_value),
        "matched": revisit.matched,
        "psi_per_point": revisit.psi,
        "psi_per_point_best": revisit.psi_best,
    }


def list_step(step: StepAudit, sweeps: Sweeps, *, jumps: bool) -> StepRow:
    """Returns the row of a step."""
    laid, pose = step.laid, sweeps.poses[step.laid.later]
    return {
        "t": step.t,
        "x": float(pose[0]),
        "y": float(pose[1]),
        "yaw": float(pose[2]),
        "dx": float(laid.offset[0]),
        "dy": float(laid.offset[1]),
        "dyaw": float(laid.offset[2]),
        "size_m": laid.size_m,
        "matched": laid.matched,
        "p_value": _known(step.p_value),
        "torn": jumps if step.judged else None,
    }


def list_span(span: SpanAudit, sweeps: Sweeps) -> SpanRow:
    """Returns the row of a span, whose offset is without what all of the map asks for."""
    laid, pose = span.laid, sweeps.poses[span.laid.later]
    return {
        "t_earlier": span.t0,
        "t_later": span.t1,
        "x": float(pose[0]),
        "y": float(pose[1]),
        "yaw": float(pose[2]),
        "path_m": laid.path_m,
        "dx": float(span.offset[0]),
        "dy": float(span.offset[1]),
        "dyaw": float(span.offset[2]),
        "matched": laid.matched,
        "p_value": _known(span.p_value),
        "torn": span.torn if np.isfinite(span.p_value) else None,
    }


def _known(p_value: float) -> float | None:
    """Returns a p-value, or None where nothing was judged."""
    return p_value if np.isfinite(p_value) else None
