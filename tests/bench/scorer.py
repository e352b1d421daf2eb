"""The judge of trajectories: knows nothing of mqslam's own code, and stands on evo.

Poses are compared at the ground truth's own stamps, as far as the estimate reaches: it is interpolated (positions along a
line, headings along the shortest arc) and never extrapolated. A pose belongs to the stamp of its line in the file, so the
writer of a file answers for the time that a pose belongs to. How well measurements and poses know their own errors is the
squared error of each, normalised by its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from evo.core import geometry, lie_algebra, metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SEGMENTS_M = range(100, 801, 100)  # KITTI's
_START_STEP = 4  # a segment begins at every fourth pose
_SLACK_S = 2e-3  # a stamp may be rounded to milliseconds
_FOLLOWED = 1.0  # the largest error of a step that still follows the motion [m/s]
_FREEDOM = 3  # degrees: x, y and yaw
_EVERY = 30  # scans between the poses that are judged by their covariances: the errors of nearer ones are nearly the same


@dataclass(frozen=True, slots=True)
class Score:
    """The errors of a trajectory."""

    stamps: int  # number of stamps it is compared at
    coverage: float  # part of the ground truth's time that they span
    length_m: float  # length of the true path there [m]
    ate_rmse_m: float  # position error after the best rigid alignment in the plane, without scale [m]
    drift_percent: float | None  # translation error of KITTI's segments of 100 to 800 m [%]; None where none fits
    drift_deg_per_100m: float | None  # rotation error of the same segments [deg/100 m]
    rpe_v_rms: float  # errors of the forward speed from stamp to stamp [m/s]
    rpe_w_rms: float  # errors of the yaw rate [rad/s]
    rpe_v_bias: float  # errors of the forward speed from stamp to stamp [m/s]
    rpe_w_bias: float  # errors of the yaw rate [rad/s]
    heading_deg_per_km: float  # growth of the heading error over the whole path, counter-clockwise [deg/km]
    followed: float  # share of the steps whose forward speed is less than 1 m/s off


def score(estimate: Path, truth: Path) -> Score:
    """Returns the errors of a trajectory.

    Args:
        estimate: TUM file.
        truth: TUM file, or the table of relative motions of an Oxford recording.

    Raises:
        ValueError: the stamps of the estimate do not increase, or the two share fewer than three stamps.
    """
    estimated, true, whole_s = _take_shared(read_trajectory(estimate), read_trajectory(truth))
    seconds = np.diff(true.timestamps)
    steps = _steps(estimated) - _steps(true)
    speeds, rates = steps[:, 0] / seconds, wrap(steps[:, 2]) / seconds
    travelled = np.r_[0.0, np.cumsum(np.hypot(*np.diff(true.positions_xyz[:, :2], axis=0).T))]
    translation, rotation = _measure_segments(estimated, true, travelled)
    turned = np.unwrap(wrap(headings(estimated) - headings(true)))
    return Score(
        stamps=len(true.timestamps),
        coverage=float((true.timestamps[-1] - true.timestamps[0]) / whole_s),
        length_m=float(travelled[-1]),
        ate_rmse_m=_measure_ate(estimated, true),
        drift_percent=100.0 * float(translation.mean()) if len(translation) else None,
        drift_deg_per_100m=100.0 * float(np.rad2deg(rotation.mean())) if len(rotation) else None,
        rpe_v_rms=float(np.sqrt(np.mean(speeds**2))),
        rpe_w_rms=float(np.sqrt(np.mean(rates**2))),
        rpe_v_bias=float(speeds.mean()),
        rpe_w_bias=float(rates.mean()),
        heading_deg_per_km=float(np.rad2deg(turned[-1] - turned[0]) / (1e-3 * travelled[-1])),
        followed=float(np.mean(np.abs(speeds) < _FOLLOWED)),
    )


def measure_nees(measurements: Path, stamps: Path, truth: Path) -> Array:
    """Returns the normalised squared errors (N,) of measurements over their degrees of freedom: 1 on average if right.

    Args:
        measurements: table of relative motions with their covariances.
        stamps: TUM file whose first stamp is the start of the recording.
        truth: TUM file.
    """
    table = np.genfromtxt(measurements, delimiter=",", names=True, usecols=range(11), ndmin=1)
    start = read_trajectory(stamps).timestamps[0]
    true = read_trajectory(truth)
    first, last = (place(true, start + table[name]) for name in ("t0", "t1"))
    yaw, turned = headings(first), headings(last)
    dx, dy = (last.positions_xyz - first.positions_xyz)[:, :2].T
    moved = np.c_[np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx, turned - yaw]
    error = np.c_[table["dx"], table["dy"], table["dyaw"]] - moved
    error[:, 2] = wrap(error[:, 2])
    return _normalise(error, table)


def measure_pose_nees(run: Path, truth: Path) -> float | None:
    """Returns the mean normalised squared error of every 30th pose over its degrees of freedom; None where it is not known.

    A pose is held against the truth relative to the first pose, which the graph holds where it is: so the marginal
    covariance of the pose alone is that of its error. Between two poses that are both free it would take their joint one.

    Args:
        run: folder with `trajectory.tum` and, where the covariances are known, `covariances.csv`.
        truth: TUM file.
    """
    if not (run / "covariances.csv").is_file():
        return None
    table = np.genfromtxt(run / "covariances.csv", delimiter=",", names=True, ndmin=1)
    track = read_trajectory(run / "trajectory.tum")
    true = place(read_trajectory(truth), track.timestamps)
    judged = range(_EVERY, track.num_poses, _EVERY)
    if not judged:
        return None
    error = np.array([relative(track, 0, k) - relative(true, 0, k) for k in judged])
    error[:, 2] = wrap(error[:, 2])
    return float(_normalise(error, table[judged]).mean())


def read_trajectory(path: Path) -> PoseTrajectory3D:
    """Reads a TUM file, or the table of relative motions of an Oxford recording (y to the right, yaw clockwise)."""
    with path.open(encoding="utf-8") as file:
        oxford = "source_timestamp" in file.readline()
    if not oxford:
        return file_interface.read_tum_trajectory_file(str(path))
    rows = np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)
    rows = rows[np.argsort(rows[:, 0])]  # a row moves from its destination, the earlier stamp, to its source
    poses = [np.eye(4)]
    for row in rows:
        motion = lie_algebra.se3(turn(-row[7]), np.array([row[2], -row[3], 0.0]))
        poses.append(poses[-1] @ motion)
    return PoseTrajectory3D(poses_se3=poses, timestamps=np.r_[rows[0, 1], rows[:, 0]] * 1e-6)


def place(track: PoseTrajectory3D, stamps: Array) -> PoseTrajectory3D:
    """Returns a trajectory at other stamps (N,) [s] within its span, in the plane.

    Raises:
        ValueError: its own stamps do not increase.
    """
    if np.any(np.diff(track.timestamps) <= 0.0):
        raise ValueError("the stamps of a trajectory must increase")
    yaw = np.interp(stamps, track.timestamps, np.unwrap(headings(track)))
    x, y = (np.interp(stamps, track.timestamps, track.positions_xyz[:, k]) for k in (0, 1))
    poses = [lie_algebra.se3(turn(angle), np.array([a, b, 0.0])) for angle, a, b in zip(yaw, x, y, strict=True)]
    return PoseTrajectory3D(poses_se3=poses, timestamps=stamps)


def headings(track: PoseTrajectory3D) -> Array:
    """Returns the headings (N,) [rad] of a trajectory."""
    w, _, _, z = track.orientations_quat_wxyz.T
    return np.asarray(2.0 * np.arctan2(z, w))


def relative(track: PoseTrajectory3D, first: int, last: int) -> Array:
    """Returns the motion (3,) from one pose to another, in the frame of the first: x, y [m], yaw [rad]."""
    motion = lie_algebra.relative_se3(track.poses_se3[first], track.poses_se3[last])
    return np.array([motion[0, 3], motion[1, 3], np.arctan2(motion[1, 0], motion[0, 0])])


def turn(yaw: float) -> Array:
    """Returns the rotation (3, 3) by an angle [rad] in the plane."""
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])


def wrap(angles: Array) -> Array:
    """Returns angles within half a turn of zero."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def _take_shared(estimate: PoseTrajectory3D, truth: PoseTrajectory3D) -> tuple[PoseTrajectory3D, PoseTrajectory3D, float]:
    """Returns both at the stamps of the truth that the estimate covers, and the time [s] that the whole truth spans."""
    stamps = truth.timestamps
    inside = stamps[(stamps >= estimate.timestamps[0] - _SLACK_S) & (stamps <= estimate.timestamps[-1] + _SLACK_S)]
    if len(inside) < 3:
        raise ValueError("estimate and ground truth share fewer than 3 stamps")
    return place(estimate, inside), place(truth, inside), float(stamps[-1] - stamps[0])


def _measure_ate(estimated: PoseTrajectory3D, true: PoseTrajectory3D) -> float:
    rotated, shift, _ = geometry.umeyama_alignment(estimated.positions_xyz[:, :2].T, true.positions_xyz[:, :2].T)
    rotation = np.eye(3)
    rotation[:2, :2] = rotated
    aligned = PoseTrajectory3D(poses_se3=[*estimated.poses_se3], timestamps=estimated.timestamps)
    aligned.transform(lie_algebra.se3(rotation, np.r_[shift, 0.0]))
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((true, aligned))
    return float(error.get_statistic(metrics.StatisticsType.rmse))


def _measure_segments(estimated: PoseTrajectory3D, true: PoseTrajectory3D, travelled: Array) -> tuple[Array, Array]:
    """Returns the errors of all segments per metre: (N,) [m/m], (N,) [rad/m]."""
    translation, rotation = [], []
    for length in _SEGMENTS_M:
        for first in range(0, len(travelled), _START_STEP):
            last = int(np.searchsorted(travelled, travelled[first] + length))
            if last == len(travelled):
                break
            a, b = (lie_algebra.relative_se3(track.poses_se3[first], track.poses_se3[last]) for track in (true, estimated))
            error = lie_algebra.relative_se3(a, b)
            translation.append(np.hypot(error[0, 3], error[1, 3]) / length)
            rotation.append(abs(np.arctan2(error[1, 0], error[0, 0])) / length)
    return np.array(translation), np.array(rotation)


def _steps(track: PoseTrajectory3D) -> Array:
    return np.array([relative(track, k, k + 1) for k in range(track.num_poses - 1)])


def _normalise(error: Array, table: NDArray[np.void]) -> Array:
    """Returns the squared errors (N,) of motions (N, 3), normalised by the covariances of a table's rows."""
    xx, xy, xw, yy, yw, ww = (table[f"cov_{name}"] for name in ("xx", "xy", "xyaw", "yy", "yyaw", "yawyaw"))
    covariance = np.moveaxis(np.array([[xx, xy, xw], [xy, yy, yw], [xw, yw, ww]]), 2, 0)
    normalised = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return np.asarray(normalised / _FREEDOM)
