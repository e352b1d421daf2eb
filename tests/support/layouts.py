"""A simulated drive written in the layouts of public datasets, byte by byte."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from support.recordings import bag_writer, with_metadata

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.simulator import ConstantDrive, SensorModel, SimulatedRecording, make_yard_scene, simulate_recording

NS = 417
"""What the stamps of a recording in ns have beyond whole microseconds [ns]."""


@lru_cache(maxsize=1)
def left_turn() -> SimulatedRecording:
    """Returns six small polar scans of a drive that turns left, 8 m/s and 0.4 rad/s."""
    sensor = SensorModel(azimuths=40, range_resolution=0.5, max_range=100.0)
    return simulate_recording(make_yard_scene(1), ConstantDrive(8.0, 0.4), duration_s=1.5, sensor=sensor)


def truth_at(recording: SimulatedRecording, stamps_us: NDArray[np.int64]) -> Trajectory:
    """Returns the true poses of the radar at stamps (N,) [us]."""
    return Trajectory(stamps_us, recording.drive.poses((stamps_us - recording.start_us) * 1e-6))


def ends(recording: Recording) -> list[int]:
    """Returns the ends of the turns of a recording without gaps [us]."""
    return [*recording.stamps_us[1:].tolist(), recording.end_us]


def rows_of(recording: SimulatedRecording, k: int, flags: NDArray[np.bool_], per_us: int = 1) -> NDArray[np.uint8]:
    """Returns polar scan k as Oxford rows with flags (A,) in byte 10 and `per_us` ticks of time in a microsecond."""
    stamps = recording.azimuth_stamps(k) * per_us + (NS if per_us == 1000 else 0)
    return with_metadata(recording[k].power, stamps, recording.sensor.encoders, flags)


def write_boreas(folder: Path, recording: SimulatedRecording, flags: NDArray[np.bool_] | None = None) -> Path:
    """Writes a recording as Boreas: images named after the middle of the turn, poses of that instant."""
    (folder / "radar").mkdir(parents=True)
    (folder / "applanix").mkdir()
    flags = np.ones(recording.sensor.azimuths, dtype=np.bool_) if flags is None else flags
    middles = [int(recording.azimuth_stamps(k)[recording.sensor.azimuths // 2 - 1]) for k in range(len(recording))]
    for k, middle in enumerate(middles):
        Image.fromarray(rows_of(recording, k, flags)).save(folder / "radar" / f"{middle}.png")
    lines = ["GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"]
    for stamp, (x, y, yaw) in zip(middles, truth_at(recording, np.array(middles)).poses.tolist(), strict=True):
        roll, pitch, heading = boreas_angles(yaw, nose_up=0.04, left_side_up=0.02)
        lines.append(f"{stamp},{x + 623_000.0:.6f},{y + 4_848_000.0:.6f},154,0,0,0,{roll},{pitch},{heading},0,0,0")
    (folder / "applanix" / "radar_poses.csv").write_text("\n".join(lines) + "\n")
    return folder


def boreas_angles(yaw: float, *, nose_up: float, left_side_up: float) -> tuple[float, float, float]:
    """Returns roll, pitch and heading of Boreas' file for a radar that looks along a yaw, tilted [rad].

    The columns of C_enu_radar are the radar's forward, right and down in east, north, up; C = R1 R2 R3.
    """
    forward = np.array([np.cos(nose_up) * np.cos(yaw), np.cos(nose_up) * np.sin(yaw), np.sin(nose_up)])
    level_right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    right = np.cos(left_side_up) * level_right - np.sin(left_side_up) * np.cross(level_right, forward)
    c = np.column_stack([forward, right, np.cross(forward, right)])
    return float(np.arctan2(c[1, 2], c[2, 2])), float(-np.arcsin(c[0, 2])), float(np.arctan2(c[0, 1], c[0, 0]))


def write_mulran_columns(root: Path, recording: SimulatedRecording) -> Path:
    """Writes a recording as MulRan's polar images, named after the ends of the turns [ns]."""
    folder = root / "sensor_data" / "radar" / "polar"
    folder.mkdir(parents=True)
    for end, polar_scan in zip(ends(recording), recording.polar_scans(), strict=True):
        Image.fromarray(polar_scan.power.T).save(folder / f"{end * 1000 + NS}.png")
    return root


def write_mulran_rows(root: Path, recording: SimulatedRecording, inside: str = "sensor_data/radar") -> Path:
    """Writes a recording as MulRan's Oxford rows, with stamps in ns."""
    folder = root / inside / "polar_oxford_form"
    folder.mkdir(parents=True)
    for k, end in enumerate(ends(recording)):
        rows = rows_of(recording, k, np.ones(recording.sensor.azimuths, dtype=np.bool_), per_us=1000)
        Image.fromarray(rows).save(folder / f"{end * 1000 + NS}.png")
    return root


def write_mulran_poses(root: Path, recording: SimulatedRecording) -> None:
    """Writes the poses of the vehicle that carries the radar: the radar is 1.50 m ahead, 0.04 m right, turned by 0.9 deg."""
    lines = []
    stamps = recording.start_us + np.arange(0, 1_500_001, 100_000)
    radars = truth_at(recording, stamps).poses
    for stamp, pose in zip(stamps.tolist(), radars, strict=True):
        x, y, yaw = se2.compose(pose, se2.inverse([1.50, -0.04, np.deg2rad(0.9)]))
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{stamp * 1000 + NS},{c},{-s},0,{x + 353_000.0},{s},{c},0,{y + 4_026_000.0},0,0,1,20.5")
    (root / "global_pose.csv").write_text("\n".join(lines) + "\n")


def write_radiate(root: Path, recording: SimulatedRecording) -> Path:
    """Writes a recording as RADIATE: numbered images, stamps of the ends of the turns [s] in a file."""
    folder = root / "Navtech_Polar"
    folder.mkdir(parents=True)
    lines = []
    for number, (end, polar_scan) in enumerate(zip(ends(recording), recording.polar_scans(), strict=True), 1):
        Image.fromarray(polar_scan.power.T).save(folder / f"{number:06d}.png")
        lines.append(f"Frame: {number:06d} Time: {end // 1_000_000}.{end % 1_000_000:06d}{NS}")
    (root / "Navtech_Polar.txt").write_text("\n".join(lines) + "\n")
    return root


def write_player_bag(path: Path, recording: SimulatedRecording) -> Path:
    """Writes a recording as MulRan's player sends it: images of columns, stamped at the ends of the turns."""
    path = path.with_suffix(".bag")
    with bag_writer(path, "ros1") as bag:
        radar = bag.topic("/radar/polar", "sensor_msgs/msg/Image")
        for end, polar_scan in zip(ends(recording), recording.polar_scans(), strict=True):
            bag.write(radar, end, bag.image(end, polar_scan.power.T))
    return path


def assert_alike(a: Recording, b: Recording) -> None:
    """Checks that two recordings hold the same power at the same times and angles, to a microsecond."""
    np.testing.assert_allclose(a.stamps_us - b.stamps_us, 0, atol=1)
    assert abs(a.end_us - b.end_us) <= 1
    for one, other in zip(a.polar_scans(), b.polar_scans(), strict=True):
        assert_alike_polar_scan(one, other)


def assert_alike_polar_scan(a: PolarScan, b: PolarScan) -> None:
    """Checks that two polar scans hold the same power at the same times and angles, to a microsecond."""
    np.testing.assert_array_equal(a.power, b.power)
    np.testing.assert_array_equal(a.valid, b.valid)
    np.testing.assert_allclose(a.times, b.times, rtol=0.0, atol=1.001e-6)
    np.testing.assert_allclose(a.azimuths, b.azimuths, rtol=0.0, atol=1e-9)


def assert_turns_left(truth: Trajectory | None, recording: SimulatedRecording, stamps_us: NDArray[np.int64]) -> None:
    """Checks that ground truth goes forward and to the left, whatever the fixed frame."""
    assert truth is not None
    np.testing.assert_array_equal(truth.stamps_us, stamps_us)
    moved = se2.between(truth.poses[:1], truth.poses)
    expected = truth_at(recording, stamps_us).poses
    np.testing.assert_allclose(moved, se2.between(expected[:1], expected), rtol=0.0, atol=1e-5)
    assert moved[-1, 0] > 1.0 and moved[-1, 1] > 0.1 and moved[-1, 2] > 0.1
