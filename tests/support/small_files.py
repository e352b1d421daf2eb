"""A small valid file or folder for each reader that is fuzzed."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gtsam
import laspy
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from support.keyframe_maps import two_recordings
from support.layouts import (
    left_turn,
    write_boreas,
    write_mulran_columns,
    write_mulran_poses,
    write_radiate,
)
from support.recordings import START_US, TURN_US, bag_path, bag_writer, circle, write_bag, write_oxford
from support.sensors import (
    RATE,
    gga,
    rmc,
    write_applanix_gps,
    write_applanix_imu,
    write_dmi,
    write_dmu,
    write_gnss_csv,
    write_imu_csv,
    write_ins,
    write_lines,
    write_matrix,
    write_mulran_gps,
    write_mulran_imu,
    write_oxford_gps,
    write_radiate_messages,
)

from mqslam.config import Config, dump_yaml
from mqslam.core.trajectory import Trajectory
from mqslam.formats.bags import TF_TYPE
from mqslam.formats.bags import write_bag as write_result_bag
from mqslam.formats.covariances import StampedCovariances, write_covariances
from mqslam.formats.lidars import laserscan
from mqslam.formats.maps.keyframe_folder import write_keyframes
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.native import write as write_native
from mqslam.formats.recordings.rosbag import write as write_own_bag
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import write_tum


def oxford(folder: Path) -> Path:
    drive = write_oxford(folder / "drive")
    (drive / "odom.csv").write_text("t,v,omega\n" + "".join(f"{START_US + 10**5 * k},8.0,0.1\n" for k in range(20)))
    (drive / "simulation.json").write_text('{"range_resolution_m": 0.175}\n')
    (drive / "gt").mkdir()
    rows = [f"{START_US + k * TURN_US},{START_US + (k - 1) * TURN_US},2.0,0.0,0,0,0,0.01,1,2\n" for k in range(1, 7)]
    (drive / "gt" / "radar_odometry.csv").write_text("a,b,x,y,z,roll,pitch,yaw,c,d\n" + "".join(rows))
    write_imu_csv(drive / "imu.csv")
    write_gnss_csv(drive / "gnss.csv")
    (drive / "recording.json").write_text(
        '{"range_resolution_m": 0.175, "radar_on_vehicle": {"x_m": 1.0, "y_m": 0.0, "yaw_rad": 0.1}}'
    )
    return drive


def oxford_ins(folder: Path) -> Path:
    """Writes what Oxford's dataset has of its car's INS, beside the radar."""
    drive = write_oxford(folder / "drive")
    write_ins(drive / "gps" / "ins.csv", 0.1)
    write_oxford_gps(drive / "gps" / "gps.csv")
    return drive


def boreas(folder: Path) -> Path:
    drive = write_boreas(folder / "drive", left_turn())
    write_applanix_imu(drive / "applanix" / "imu_raw.csv", RATE)
    write_applanix_gps(drive / "applanix" / "gps_post_process.csv", 0.76, -1.38)
    write_matrix(drive / "calib" / "T_applanix_lidar.txt", np.eye(4))
    write_matrix(drive / "calib" / "T_radar_lidar.txt", np.diag([1.0, -1.0, -1.0, 1.0]))
    return drive


def boreas_rt(folder: Path) -> Path:
    """Writes a drive whose chirps go up and down, with a wheel encoder and a gyroscope."""
    drive = write_boreas(folder / "drive", left_turn(), np.arange(left_turn().sensor.azimuths) % 2 == 0)
    write_dmu(drive / "imu" / "dmu_imu.csv", RATE, left_turn().start_us)
    write_dmi(drive / "applanix" / "dmi.csv", 8.0, left_turn().start_us)
    return drive


def own_bag(folder: Path) -> Path:
    """Writes a bag as the package does, with all sensors."""
    write_own_bag("mcap", "image", folder / "drive.mcap", open_recording(oxford(folder)))
    return folder / "drive.mcap"


def dmu(folder: Path) -> Path:
    write_matrix(folder / "calib" / "T_applanix_dmu.txt", np.diag([1.0, -1.0, -1.0, 1.0]))
    write_dmu(folder / "imu" / "dmu_imu.csv", RATE)
    return folder


def nmea(folder: Path) -> Path:
    lines = [rmc("221319.00", "141123"), *(gga(f"2213{second}.00") for second in range(20, 40))]
    return write_lines(folder / "log.nmea", *lines)


def mulran(folder: Path) -> Path:
    drive = write_mulran_columns(folder / "drive", left_turn())
    write_mulran_poses(drive, left_turn())
    write_mulran_imu(drive / "xsens_imu.csv")
    write_mulran_gps(drive / "gps.csv")
    return drive


def radiate(folder: Path) -> Path:
    """Writes a recording with all sensors, whose turns each lost an azimuth."""
    drive = write_radiate(folder / "drive", left_turn())
    write_radiate_messages(drive, count=6)
    images = sorted((drive / "Navtech_Polar").glob("*.png"))
    whole = [np.asarray(Image.open(image)) for image in images]
    for image, before, pixels in zip(images[1:], whole, whole[1:], strict=False):
        Image.fromarray(np.column_stack([np.delete(pixels, 20, axis=1), before[:, -1]])).save(image)
    return drive


def native(folder: Path) -> Path:
    write_native(folder / "drive.npz", open_recording(oxford(folder)))
    return folder / "drive.npz"


def bag(kind: str) -> Callable[[Path], Path]:
    return lambda folder: write_bag(open_recording(oxford(folder)), bag_path(folder, kind), kind)


def scans(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = bag_path(folder, kind)
        with bag_writer(path, kind) as bag:
            types = bag.store.types
            lidar, wheels = bag.topic("/scan", laserscan.SCAN_TYPE), bag.topic("/odom", "nav_msgs/msg/Odometry")
            for k in range(4):
                stamp = START_US + k * 100_000
                message = types[laserscan.SCAN_TYPE](
                    bag.header(stamp),
                    angle_min=-1.0,
                    angle_max=1.0,
                    angle_increment=0.1,
                    time_increment=1e-3,
                    scan_time=0.1,
                    range_min=0.1,
                    range_max=30.0,
                    ranges=np.linspace(1, 20, 21).astype(np.float32),
                    intensities=np.zeros(0, np.float32),
                )
                bag.write(lidar, stamp, message)
                bag.write(wheels, stamp, bag.odometry(stamp, np.array([0.1 * k, 0.0, 0.01])))
        return path

    return write


def carmen_log(folder: Path) -> Path:
    lines = ["PARAM robot_front_laser_max 30.0 host 0\n"]
    for k in range(4):
        pose = f"{0.1 * k} 0 0.01"
        lines.append(f"ODOM {pose} 0 0 0 {k}.5 host {k}.5\n")
        lines.append(f"FLASER 5 1 2 3 4 81.9 {pose} {pose} {k}.5 host {k}.5\n")
        lines.append(f"ROBOTLASER1 0 -1.5 3.1 0.6 30.0 0.01 0 5 1 2 3 4 5 0 {pose} {pose} 0 0 0 0 0 {k}.6 host {k}.6\n")
    (folder / "drive.log").write_text("".join(lines))
    return folder / "drive.log"


def carmen_gzip(folder: Path) -> Path:
    (folder / "drive.log.gz").write_bytes(gzip.compress(carmen_log(folder).read_bytes()))
    return folder / "drive.log.gz"


_POINTS = np.column_stack([np.linspace(0, 9, 40), np.linspace(-3, 3, 40), np.zeros(40), np.linspace(0, 3.9, 40)])


def ply(body: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "time"))
        header = f"ply\nformat {body} 1.0\nelement vertex {len(_POINTS)}\n{properties}end_header\n"
        rows = "".join(" ".join(map(str, row)) + "\n" for row in _POINTS.tolist()).encode()
        (folder / "map.ply").write_bytes(header.encode() + (rows if body == "ascii" else _POINTS.astype("<f8").tobytes()))
        return folder / "map.ply"

    return write


def pcd(data: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        from pypcd4 import Encoding, PointCloud

        cloud = PointCloud.from_points(_POINTS, ("x", "y", "z", "t"), (np.float64,) * 4)
        cloud.save(folder / "map.pcd", encoding=Encoding(data))
        return folder / "map.pcd"

    return write


def las(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        content = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
        content.x, content.y, content.z, content.gps_time = _POINTS.T
        content.write(str(folder / f"map.{suffix}"))
        return folder / f"map.{suffix}"

    return write


def npz(folder: Path) -> Path:
    np.savez(folder / "map.npz", points=_POINTS[:, :3], t=_POINTS[:, 3])
    return folder / "map.npz"


def _track() -> Trajectory:
    return circle(START_US + TURN_US * np.arange(20))


def tum(folder: Path) -> Path:
    write_tum(folder / "track.tum", _track())
    return folder / "track.tum"


def kitti(folder: Path) -> Path:
    (folder / "track").mkdir()
    write_kitti(folder / "track" / "poses.txt", _track())
    (folder / "track" / "times.txt").write_text("".join(f"{stamp * 1e-6:.6f}\n" for stamp in _track().stamps_us.tolist()))
    return folder / "track"


def matrices(folder: Path) -> Path:
    """Writes poses as the matrices of an array, and their stamps."""
    path = kitti(folder)
    numbers = np.loadtxt(path / "poses.txt").reshape(-1, 3, 4)
    (path / "poses.txt").unlink()
    np.save(path / "poses.npy", numbers)
    return path


def graph(folder: Path) -> Path:
    """Writes poses as matrices, each with its stamp behind."""
    rows = (kitti(folder) / "poses.txt").read_text().splitlines()
    lines = [f"{row} {1000 * stamp}\n\n" for row, stamp in zip(rows, _track().stamps_us.tolist(), strict=True)]
    (folder / "graph.txt").write_text("".join(lines))
    return folder / "graph.txt"


def transforms(folder: Path) -> Path:
    """Writes poses as transforms from the map to the radar."""
    with write_result_bag(folder / "track.mcap", "mcap") as bag:
        topic = bag.topic("/tf", TF_TYPE)
        for stamp, pose in zip(_track().stamps_us.tolist(), _track().poses, strict=True):
            x, y, yaw = pose.tolist()
            move = bag.make("geometry_msgs/msg/Transform", bag.vector(x, y, 0.0), bag.quaternion(yaw))
            stamped = bag.make("geometry_msgs/msg/TransformStamped", bag.header(stamp, "map"), "radar", move)
            bag.write(topic, stamp, bag.make(TF_TYPE, [stamped]))
    return folder / "track.mcap"


def csv(folder: Path) -> Path:
    rows: NDArray[Any] = np.column_stack([_track().stamps_us * 1000, _track().poses])
    text = "time_ns,x,y,yaw\n" + "".join(f"{int(t)},{x},{y},{yaw}\n" for t, x, y, yaw in rows.tolist())
    (folder / "track.csv").write_text(text)
    return folder / "track.csv"


def covariances(folder: Path) -> Path:
    shape = np.array([[0.04, 0.01, 0.001], [0.01, 0.09, -0.002], [0.001, -0.002, 0.0001]])
    stamps = _track().stamps_us
    given = StampedCovariances(stamps, np.arange(1, len(stamps) + 1)[:, None, None] * shape)
    write_covariances(folder / "covariances.csv", given)
    return folder / "covariances.csv"


def pose_graph(spatial: bool) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        start, step = ("0 0 0 0 0 0 1", "1 0 0 0 0 0.1 0.995") if spatial else ("0 0 0", "1 0 0.1")
        vertex, edge = ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT") if spatial else ("VERTEX_SE2", "EDGE_SE2")
        information = np.eye(6 if spatial else 3)[np.triu_indices(6 if spatial else 3)]
        lines = [f"{vertex} {k} {start}\n" for k in range(8)]
        lines += [f"{edge} {k} {k + 1} {step} {' '.join(map(str, information))}\n" for k in range(7)]
        (folder / "graph.g2o").write_text("".join(lines) + "FIX 0\n")
        return folder / "graph.g2o"

    return write


def gtsam_archive(folder: Path) -> Path:
    """Writes a graph and its values as GTSAM does."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    for k in range(5):
        values.insert(k, gtsam.Pose2(float(k), 0.0, 0.1))
        if k:
            graph.push_back(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1.0, 0.0, 0.0), noise))
    (folder / "archive").mkdir()
    (folder / "archive" / "graph.txt").write_text(graph.serialize())
    (folder / "archive" / "values.txt").write_text(values.serialize())
    return folder / "archive"


def twists(folder: Path) -> Path:
    return oxford(folder) / "odom.csv"


def settings(folder: Path) -> Path:
    (folder / "settings.yaml").write_text(dump_yaml(Config()))
    return folder / "settings.yaml"


def plan(folder: Path) -> Path:
    """Writes what `batch` reads."""
    (folder / "runs.yaml").write_text(
        "runs:\n- {data: drive, name: one, odometry: none}\n- {data: other, extrinsics: '1,0,0.5'}\n"
    )
    return folder / "runs.yaml"


def keyframes(folder: Path) -> Path:
    write_keyframes(folder / "keyframes", two_recordings())
    return folder / "keyframes"


def nav2_map(folder: Path) -> Path:
    (folder / "map.pgm").write_bytes(b"P5\n6 4\n255\n" + bytes(range(24)))
    text = "image: map.pgm\nresolution: 0.2\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def result_folder(folder: Path) -> Path:
    """Writes what CFEAR leaves."""
    (folder / "est").mkdir()
    write_kitti(folder / "est" / "00.txt", _track())
    write_tum(folder / "est" / "tum_00.txt", _track())
    return folder
