from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.recordings import KINDS, START_US, TF, bag_path, bag_writer, write_bag, write_oxford

from mqslam.commands.inputs import open_radar_or_lidar
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.recording import LidarRecording
from mqslam.errors import DataError, OfLidarError
from mqslam.formats import bags
from mqslam.formats.bags import open_bag
from mqslam.formats.lidars.laserscan import read_lidar
from mqslam.formats.recordings import open_radar, open_recording
from mqslam.formats.recordings.layout import Sensing

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
COVARIANT = "geometry_msgs/msg/PoseWithCovarianceStamped"
PERIOD_US = 100_000


def write(path: Path, kind: str, *scans: dict[str, Any], topics: tuple[str, ...] = ("/scan",)) -> Path:
    """Writes a bag with scans a period apart on each of some topics."""
    with bag_writer(path, kind) as bag:
        connections = [bag.topic(topic, SCAN) for topic in topics]
        for k, content in enumerate(scans):
            for connection in connections:
                bag.write(connection, START_US + k * PERIOD_US, bag.scan(START_US + k * PERIOD_US, **content))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_beams_become_returns_with_times_angles_and_intensities(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    write(path, kind, {"ranges": [1, 2, 3, 4, 5], "intensities": [9, 8, 7, 6, 5]}, {"ranges": [5, 4, 3, 2, 1]})
    recording = read_lidar(path)
    assert recording.format == "laserscan" and len(recording.scans) == 2
    assert recording.scans.stamps_us.tolist() == [START_US, START_US + PERIOD_US]
    first, second = (scan.returns for scan in recording.scans)
    np.testing.assert_allclose(first.ranges, [1, 2, 3, 4, 5])
    np.testing.assert_allclose(first.azimuths, [-1, -0.5, 0, 0.5, 1])
    np.testing.assert_allclose(first.times, [0, 1e-3, 2e-3, 3e-3, 4e-3])
    np.testing.assert_allclose(first.intensities, [9, 8, 7, 6, 5])
    np.testing.assert_allclose(second.times, 0.1 + first.times)
    np.testing.assert_array_equal(second.intensities, np.zeros(5))
    np.testing.assert_allclose([(scan.t0, scan.t1) for scan in recording.scans], [(0.0, 0.1), (0.1, 0.2)])
    assert recording.trajectory is None and recording.odometry is None


@pytest.mark.parametrize(
    ("radar", "of_lidar"),
    [(None, True), ("/camera/image", True), ("/Navtech/Polar", False), ("/radar_data/fft_msg", False), ("/polar/x", False)],
)
def test_a_bag_is_a_lidars_unless_a_topic_is_named_like_a_radars(tmp_path: Path, radar: str | None, of_lidar: bool) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        scans = bag.topic("/scan", SCAN)
        beside = None if radar is None else bag.topic(radar, ODOMETRY)
        for stamp in (START_US, START_US + PERIOD_US):
            bag.write(scans, stamp, bag.scan(stamp))
            if beside is not None:
                bag.write(beside, stamp, bag.odometry(stamp, np.zeros(3)))
    with pytest.raises(DataError) as raised:
        open_radar(tmp_path / "drive.bag", None, Sensing())
    assert isinstance(raised.value, OfLidarError) is of_lidar


def test_ranges_outside_the_limits_nan_and_infinite_ones_are_no_returns(tmp_path: Path) -> None:
    content = {"ranges": [np.nan, np.inf, 0.1, 30.0, 7.0], "intensities": [1, 2, 3, 4, 5]}
    returns = read_lidar(write(tmp_path / "drive.bag", "ros1", content, content)).scans[1].returns
    np.testing.assert_allclose(returns.ranges, [7.0])
    np.testing.assert_allclose(returns.azimuths, [1.0])
    np.testing.assert_allclose(returns.times, [0.104])
    np.testing.assert_allclose(returns.intensities, [5])


@pytest.mark.parametrize(("increment", "note"), [(0.0, "no time of their own"), (0.05, "impossible"), (-1e-3, "impossible")])
def test_beams_without_usable_times_have_the_scans(tmp_path: Path, increment: float, note: str) -> None:
    content = {"ranges": [1, 2, 3, 4, 5], "time_increment": increment}
    recording = read_lidar(write(tmp_path / "drive.bag", "ros1", content, content, content))
    for scan in recording.scans:
        assert np.all(scan.returns.times == scan.t0)
    assert any(note in text for text in recording.notes)


def test_among_several_topics_the_one_named_scan_is_taken(tmp_path: Path) -> None:
    content = {"ranges": [1, 2, 3]}
    several = write(tmp_path / "a.bag", "ros1", content, content, topics=("/rear/laser", "/front/scan"))
    assert "scans from /front/scan" in read_lidar(several).notes
    for k, topics in enumerate([("/a/laser", "/b/laser"), ("/a/scan", "/b/scan")]):
        path = write(tmp_path / f"b{k}.bag", "ros1", content, content, topics=topics)
        with pytest.raises(DataError, match=rf"b{k}\.bag: has several topics of scans \({', '.join(topics)}\)"):
            read_lidar(path)


def test_scans_that_repeat_a_stamp_or_run_backward_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        topic = bag.topic("/scan", SCAN)
        for k, step in enumerate([0, 1, 1, 900, 2, 3]):
            bag.write(topic, START_US + k * PERIOD_US, bag.scan(START_US + step * PERIOD_US, [k + 1.0]))
    recording = read_lidar(path)
    assert ((recording.scans.stamps_us - START_US) // PERIOD_US).tolist() == [0, 1, 2, 3]
    assert any(note.startswith("2 scans") for note in recording.notes)


def arc(k: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return se2.exp([1.0, 0.0, 0.3], np.asarray(k))


def drive(path: Path, kind: str = "ros1", mount: Any = None) -> LidarRecording:
    """Writes a bag and reads it: scans, odometry of base_link, poses of a SLAM, a user's goal, and the lidar's mount."""
    with bag_writer(path, kind) as bag:
        types = bag.store.types
        scans, wheels, slam = bag.topic("/scan", SCAN), bag.topic("/odom", ODOMETRY), bag.topic("/amcl_pose", COVARIANT)
        goal = bag.topic("/move_base_simple/goal", POSE)
        if mount is not None:
            static = bag.topic("/tf_static", TF)
            bag.write(static, START_US, bag.transform(START_US, ("plate", "radar"), (0.2, 0.1, 0.4), mount.as_quat()))
            bag.write(static, START_US, bag.transform(START_US, ("base_link", "plate"), (0.0, 0.0, 0.1)))
        for k in range(4):
            stamp = START_US + k * PERIOD_US
            bag.write(scans, stamp, bag.scan(stamp))
            bag.write(wheels, stamp, bag.odometry(stamp, 1.1 * arc(float(k))))
            posed = bag.odometry(stamp, arc(float(k))).pose
            bag.write(slam, stamp, types[COVARIANT](bag.header(stamp), posed))
            for _ in range(3):
                bag.write(goal, stamp, bag.pose_stamped(stamp, np.array([50.0, 50.0, 0.0])))
    return read_lidar(path)


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_and_the_poses_of_a_slam_are_told_apart(tmp_path: Path, kind: str) -> None:
    recording = drive(bag_path(tmp_path, kind), kind)
    steps = np.arange(4.0)
    assert recording.odometry is not None and recording.trajectory is not None
    np.testing.assert_array_equal(recording.trajectory.stamps_us, recording.scans.stamps_us)
    np.testing.assert_allclose(recording.trajectory.poses, arc(steps), atol=1e-9)
    np.testing.assert_allclose(recording.odometry.poses, 1.1 * arc(steps), atol=1e-9)
    assert "trajectory from /amcl_pose, taken as the lidar's own motion" in recording.notes


@pytest.mark.parametrize("kind", KINDS)
def test_poses_are_carried_to_the_lidar_by_static_transforms(tmp_path: Path, kind: str) -> None:
    recording = drive(bag_path(tmp_path, kind), kind, Rotation.from_euler("z", 0.5))
    assert recording.trajectory is not None and recording.odometry is not None
    np.testing.assert_allclose(recording.trajectory.poses, se2.compose(arc(np.arange(4.0)), [0.2, 0.1, 0.5]), atol=1e-9)
    np.testing.assert_allclose(recording.odometry.poses, se2.compose(1.1 * arc(np.arange(4.0)), [0.2, 0.1, 0.5]), atol=1e-9)
    assert "odometry from /odom, converted to poses of the lidar by /tf_static" in recording.notes


def test_a_lidar_mounted_upside_down_sweeps_the_other_way(tmp_path: Path) -> None:
    turned = Rotation.from_euler("ZX", [0.5, np.pi])
    recording = drive(tmp_path / "drive.bag", mount=turned)
    returns, trajectory = recording.scans[0].returns, recording.trajectory
    assert trajectory is not None
    planar = np.column_stack([np.cos(returns.azimuths), np.sin(returns.azimuths)]) * returns.ranges[:, None]
    angles = -1.0 + 0.5 * np.arange(5)
    beams = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(5)]) * np.arange(1, 6)[:, None]
    expected = turned.apply(beams)[:, :2] + [0.2, 0.1]
    np.testing.assert_allclose(se2.transform(trajectory.poses[0], planar), expected, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_without_scans_is_named_with_its_topics(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    with bag_writer(path, kind) as bag:
        bag.write(bag.topic("/odom", ODOMETRY), START_US, bag.odometry(START_US, np.zeros(3)))
    with pytest.raises(DataError, match=rf"{path.name}: has no scans \(topics: /odom \[nav_msgs/msg/Odometry\]\)"):
        read_lidar(path)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ({"ranges": [np.inf] * 3}, "has 2 scans with increasing stamps and 0 returns"),
        ({"ranges": []}, "has 2 scans with increasing stamps and 0 returns"),
        ({"ranges": [1, 2, 3], "angle_min": np.nan}, r"the message on /scan recorded at \d+ ns has unusable angles \(nan"),
        (
            {"ranges": [1, 2, 3], "range_max": 0.0},
            r"the message on /scan recorded at \d+ ns has unusable angles .* or ranges \(0\.1",
        ),
    ],
)
def test_scans_that_cannot_be_used_are_named(tmp_path: Path, content: dict[str, Any], problem: str) -> None:
    path = write(tmp_path / "drive.bag", "ros1", content, content)
    with pytest.raises(DataError, match=rf"drive\.bag: {problem}") as raised:
        read_lidar(path)
    assert "\n" not in str(raised.value)


def test_a_bag_with_one_scan_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.bag", "ros1", {"ranges": [1.0, 2.0, np.inf]})
    with pytest.raises(DataError, match=r"has 1 scan with increasing stamps and 2 returns on /scan: too few"):
        read_lidar(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.9])
def test_a_corrupt_bag_is_named(tmp_path: Path, kind: str, keep: float) -> None:
    path = write(bag_path(tmp_path, kind), kind, *[{"ranges": np.linspace(1, 9, 400)}] * 20)
    file = next(path.glob("*.db3")) if path.is_dir() else path
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])
    with pytest.raises(DataError, match=f"{path.name}: "):
        read_lidar(path)


def test_a_radars_bag_is_opened_once_and_a_lidars_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []

    @contextmanager
    def open_and_count(path: Path) -> Iterator[Any]:
        opened.append(path)
        with open_bag(path) as reader:
            yield reader

    monkeypatch.setattr(bags, "open_bag", open_and_count)
    radar = write_bag(open_recording(write_oxford(tmp_path / "drive", polar_scans=4)), tmp_path / "radar.bag", "ros1")
    lidar = write(tmp_path / "lidar.bag", "ros1", {"ranges": [1, 2, 3]}, {"ranges": [1, 2, 3]})
    open_radar_or_lidar(radar, None, None, Config())
    assert opened == [radar]
    open_radar_or_lidar(lidar, None, None, Config())
    assert opened == [radar, lidar, lidar]
