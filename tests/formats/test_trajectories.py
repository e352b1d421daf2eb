"""Trajectories keep their stamps to the microsecond and their poses to the micrometre through files and bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.recordings import KINDS, START_US, assert_same_track, bag_path, bag_writer

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.poses import yaw_of_quaternion
from mqslam.formats.trajectories import read_trajectory, read_with_notes, write_kitti
from mqslam.formats.tum import read_tum, write_tum

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
COVARIANT = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"


@pytest.fixture
def arc() -> Trajectory:
    """A drive over more than a turn, with uneven stamps."""
    stamps = START_US + np.array([0, 252_813, 504_787, 650_000, 1_002_755, 1_251_173])
    return Trajectory(stamps, se2.exp(np.tile([8.0, 0.1, 5.5], (6, 1)), (stamps - START_US) * 1e-6))


def write_times(path: Path, trajectory: Trajectory, unit: str = "s") -> Path:
    stamps = trajectory.stamps_us.tolist()
    words = {"s": [f"{s // 10**6}.{s % 10**6:06d}" for s in stamps], "us": stamps, "ns": [1000 * s for s in stamps]}[unit]
    path.write_text("".join(f"{word}\n" for word in words))
    return path


@pytest.mark.parametrize("write", [write_tum, write_kitti])
def test_what_is_read_and_written_again_is_the_same_text(write: Callable[[Path, Trajectory], None], tmp_path: Path) -> None:
    stamps = START_US + 250_000 * np.arange(2000)
    poses = np.random.default_rng(0).uniform(-4, 4, (2000, 3))
    poses[:3, 2] = -np.pi, np.pi, 3 * np.pi
    write(first := tmp_path / "first.txt", Trajectory(stamps, poses))
    times = write_times(tmp_path / "times.txt", Trajectory(stamps, np.zeros((2000, 3))))
    write(again := tmp_path / "again.txt", read_trajectory(first, times if write is write_kitti else None))
    assert again.read_text() == first.read_text()


@pytest.mark.parametrize("unit", ["s", "us", "ns"])
def test_kitti_files_are_read_with_times_in_any_unit(arc: Trajectory, tmp_path: Path, unit: str) -> None:
    write_kitti(tmp_path / "t.kitti", arc)
    assert_same_track(read_trajectory(tmp_path / "t.kitti", write_times(tmp_path / "times.txt", arc, unit)), arc)


def test_evo_reads_the_kitti_file(arc: Trajectory, tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_kitti(tmp_path / "t.kitti", arc)
    path = file_interface.read_kitti_poses_file(str(tmp_path / "t.kitti"))
    np.testing.assert_allclose(path.positions_xyz, np.column_stack([arc.poses[:, :2], np.zeros(6)]), atol=5.1e-7)
    yaws = [np.arctan2(pose[1, 0], pose[0, 0]) for pose in path.poses_se3]
    np.testing.assert_allclose(se2.wrap(yaws - arc.poses[:, 2]), 0.0, atol=1e-8)
    assert path.check()[0]


def test_the_kitti_file_evo_writes_is_read(arc: Trajectory, tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(tmp_path / "t.tum", arc)
    track = file_interface.read_tum_trajectory_file(str(tmp_path / "t.tum"))
    file_interface.write_kitti_poses_file(str(tmp_path / "t.kitti"), track)
    assert_same_track(read_trajectory(tmp_path / "t.kitti", write_times(tmp_path / "times.txt", arc)), arc)


def kitti(poses: list[np.ndarray]) -> str:
    return "".join(" ".join(f"{number:.9e}" for number in pose[:3].ravel()) + "\n" for pose in poses)


@pytest.mark.parametrize("bumps", [0.0, 0.3])
def test_poses_of_a_camera_are_turned_into_the_ground_plane(tmp_path: Path, bumps: float) -> None:
    """The same drive as KITTI's own files hold it: x right, y down, z forward."""
    stamps = 1_000_000 * np.arange(1, 31)
    drive = Trajectory(stamps, se2.exp(np.tile([8.0, 0.0, 0.1], (30, 1)), np.arange(30.0)))
    camera = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # axes of the camera in those of the vehicle
    poses = []
    for (x, y, yaw), up in zip(drive.poses, bumps * np.sin(np.arange(30)), strict=True):
        pose = np.eye(4)
        pose[:3, :3] = camera @ Rotation.from_euler("z", yaw).as_matrix() @ camera.T
        pose[:3, 3] = camera @ [x, y, up]
        poses.append(pose)
    (tmp_path / "00.txt").write_text(kitti(poses))
    (tmp_path / "times.txt").write_text("".join(f"{stamp * 1e-6:e}\n" for stamp in stamps))
    assert_same_track(read_trajectory(tmp_path / "00.txt", tmp_path / "times.txt"), drive)


def test_a_straight_drive_over_hills_is_not_taken_for_a_cameras(tmp_path: Path) -> None:
    poses = [np.eye(4) for _ in range(20)]
    for k, pose in enumerate(poses):
        pose[:3, 3] = 2.0 * k, 0.01 * np.sin(k), 0.5 * np.sin(0.3 * k)
    (tmp_path / "t.kitti").write_text(kitti(poses))
    (tmp_path / "times.txt").write_text("".join(f"{k}\n" for k in range(20)))
    result = read_trajectory(tmp_path / "t.kitti", tmp_path / "times.txt")
    np.testing.assert_allclose(result.poses[:, 0], 2.0 * np.arange(20))


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("t,x,y,yaw", "s"),
        ("timestamp_ns,x,y,theta", "ns"),
        ("Time [us], X [m], Y [m], Heading [rad]", "us"),
        ("#timestamp,x,y,yaw", "ns"),
        ("stamp,x,y,yaw", "us"),
        ('"t_ms","x","y","yaw"', "ms"),
    ],
)
def test_csv_columns_are_found_by_name_and_their_unit_by_name_or_size(
    arc: Trajectory, tmp_path: Path, header: str, scale: str
) -> None:
    rows = [header]
    for stamp, (x, y, yaw) in zip(arc.stamps_us.tolist(), arc.poses.tolist(), strict=True):
        word = {"s": f"{stamp / 1e6:.6f}", "ms": f"{stamp / 1e3:.3f}", "us": str(stamp), "ns": str(1000 * stamp)}[scale]
        rows.append(f"{word}, {x:.9f}, {y:.9f}, {yaw:.9f}")
    (tmp_path / "t.csv").write_text("\n".join(rows))
    assert_same_track(read_trajectory(tmp_path / "t.csv"), arc)


def test_csv_quaternions_in_any_order_of_columns_are_read(arc: Trajectory, tmp_path: Path) -> None:
    rows = ["frame,qw,qx,qy,qz,y,x,z,t_us"]
    for k, (stamp, (x, y, yaw)) in enumerate(zip(arc.stamps_us.tolist(), arc.poses.tolist(), strict=True)):
        rows.append(f"{k},{np.cos(yaw / 2)},0,0,{np.sin(yaw / 2)},{y},{x},7,{stamp}")
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    assert_same_track(read_trajectory(tmp_path / "t.csv"), arc)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("message_type", [ODOMETRY, POSE, COVARIANT, PATH])
def test_topics_of_poses_are_read(arc: Trajectory, tmp_path: Path, kind: str, message_type: str) -> None:
    with bag_writer(bag_path(tmp_path, kind), kind) as bag:
        types, topic = bag.store.types, bag.topic("/slam", message_type)
        poses = []
        for stamp, pose in zip(arc.stamps_us.tolist(), arc.poses, strict=True):
            poses.append(bag.pose_stamped(stamp, pose))
            message = {
                ODOMETRY: lambda s=stamp, p=pose: bag.odometry(s, p),
                POSE: lambda s=stamp, p=pose: bag.pose_stamped(s, p),
                COVARIANT: lambda s=stamp, p=pose: types[COVARIANT](bag.header(s), bag.odometry(s, p).pose),
                PATH: lambda s=stamp: types[PATH](bag.header(s), [*poses]),
            }[message_type]()
            bag.write(topic, stamp, message)
    assert_same_track(read_trajectory(bag_path(tmp_path, kind)), arc)


def test_one_of_several_topics_has_to_be_named(arc: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        wheels, slam, text = bag.topic("/odom", ODOMETRY), bag.topic("/slam", POSE), bag.topic("/log", "std_msgs/msg/Header")
        bag.write(text, START_US, bag.header(START_US))
        for stamp, pose in zip(arc.stamps_us.tolist(), arc.poses, strict=True):
            bag.write(wheels, stamp, bag.odometry(stamp, 1.1 * pose))
            bag.write(slam, stamp, bag.pose_stamped(stamp, pose))
    assert_same_track(read_trajectory(path, topic="/slam"), arc)
    with pytest.raises(DataError, match=r"drive\.bag: has 2 topics of poses \(topics of poses: /odom, /slam\)"):
        read_trajectory(path)
    with pytest.raises(DataError, match=r"drive\.bag: has no poses on /log \(topics of poses: /odom, /slam\)"):
        read_trajectory(path, topic="/log")


def test_invalid_poses_of_a_bag_are_left_out_and_counted(arc: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        topic = bag.topic("/slam", POSE)
        for k, (stamp, pose) in enumerate(zip(arc.stamps_us.tolist(), arc.poses, strict=True)):
            message = bag.pose_stamped(stamp, pose)
            if k in (1, 3):
                turn = message.pose.orientation
                turn.x = turn.y = turn.z = turn.w = 0.0
            if k == 4:
                message.pose.position.x = 2e9
            bag.write(topic, stamp, message)
    track, notes = read_with_notes(path)
    assert len(track) == len(arc) - 3
    why = "a quaternion of zeros, numbers that are not finite, or a place over 1e9 m away"
    assert notes == [f"3 of {len(arc)} poses on /slam are left out: {why}"]


def test_a_bag_without_two_poses_is_refused(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "none.bag", "ros1") as bag:
        bag.write(bag.topic("/log", "std_msgs/msg/Header"), START_US, bag.header(START_US))
    with pytest.raises(DataError, match=r"none\.bag: has no topics of poses \(topics: /log \[std_msgs/msg/Header\]\)"):
        read_trajectory(tmp_path / "none.bag")
    with bag_writer(tmp_path / "still.bag", "ros1") as bag:
        topic = bag.topic("/slam", POSE)
        for k in range(3):
            bag.write(topic, START_US + k, bag.pose_stamped(0, np.zeros(3)))
    with pytest.raises(DataError, match=r"still\.bag: holds no two valid poses at different times on /slam"):
        read_trajectory(tmp_path / "still.bag")


@pytest.mark.parametrize(("turn", "first"), [(2.0 * np.pi, 0.0), (0.6, 1.0)])
def test_yaw_in_degrees_without_a_unit_is_refused_and_wound_radians_are_not(
    tmp_path: Path, turn: float, first: float
) -> None:
    yaw = np.linspace(0.0, turn, 50)
    x, y = np.cumsum(np.cos(yaw)), np.cumsum(np.sin(yaw))

    def read(name: str, yaws: np.ndarray) -> Trajectory:
        path = tmp_path / "t.csv"
        np.savetxt(path, np.column_stack([np.arange(50), x, y, yaws]), delimiter=",", header=f"t,x,y,{name}", comments="")
        return read_trajectory(path)

    degrees = np.degrees(yaw + first)
    with pytest.raises(DataError, match=r"the column yaw states no unit, .* such as yaw \[deg\] or yaw \[rad\]"):
        read("yaw", degrees)
    np.testing.assert_allclose(read("yaw [deg]", degrees).poses[:, 2], yaw + first)
    np.testing.assert_allclose(read("yaw [rad]", degrees).poses[:, 2], degrees)
    np.testing.assert_allclose(read("yaw", yaw + first + 4.0 * np.pi).poses[:, 2], yaw + first + 4.0 * np.pi)


KITTI_LINE = "1 0 0 {} 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"", "is no trajectory in a known format: the file is empty"),
        (b"# nothing, but words\n", "is no trajectory in a known format: the file holds nothing but comments"),
        (b"1 2 3\n", r"is no trajectory in a known format \(3 words in its .* TUM \(8 numbers per line, or 20, 29 or 44 w"),
        (b"1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "stamps do not increase at pose 2"),
        (b"t,x,y\n1,2,3\n2,3,4\n", r"has no column yaw \(columns: t, x, y\)"),
        (b"t,x,y,qx,qy\n1,2,3,0,0\n", r"has no column qz, qw \(columns: t, x, y, qx, qy\)"),
        (b"1,2,3,0\n2,3,4,0\n", "has no header: its first line is made of numbers"),
        (b"t;x;y;yaw\n1;2;3;0\n", "is no trajectory in a known format: its columns are separated by semicolons; use commas"),
        (b"t,x,y,yaw\n1,2,3,0\n", "holds 1 pose;"),
        (b"t,x,y,yaw\n", "holds 0 poses"),
        (b"t,x,y,qx,qy,qz,qw\n1,2,3,0,0,0,1\n2,3,4,0,0,0,0\n", "pose 2 has a quaternion of zeros"),
        (b"t,x,y,yaw\n1,2,3,0\n2,3\n", "pose 2 is not made of finite numbers"),
        (b"t,x,y,yaw\n1,2,3,0\n2,3,4,nan\n", "pose 2 is not made of finite numbers"),
        (b"t,x,y,yaw\n1,2,3,0\n2,3,4,left\n", "pose 2 is not made of finite numbers"),
        (b"t,x,y,yaw\n2,2,3,0\n1,3,4,0\n", "stamps do not increase at pose 2"),
        (b"t_s,x,y,yaw\n1,2,3,0\n1e300,3,4,0\n", "holds stamps too large for any clock"),
        ((2 * KITTI_LINE).encode(), "is a KITTI trajectory, which holds no stamps"),
    ],
)
def test_a_file_that_is_no_trajectory_is_named_in_one_line(tmp_path: Path, text: bytes, problem: str) -> None:
    (tmp_path / "t.txt").write_bytes(text)
    with pytest.raises(DataError, match=rf"t\.txt: {problem}") as raised:
        read_trajectory(tmp_path / "t.txt")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "times", "problem"),
    [
        (KITTI_LINE.format(0) + KITTI_LINE.format(1), "0\n", r"times\.txt: holds 1 stamp for the 2 poses of t\.kitti"),
        (KITTI_LINE.format(0) + KITTI_LINE.format(1), "0\n0\n", r"t\.kitti: stamps do not increase at pose 2"),
        (KITTI_LINE.format(0) + KITTI_LINE.format(1), "0\nsoon\n", r"times\.txt: holds stamps that are no numbers"),
        (KITTI_LINE.format(0) + "1 0 0\n", "0\n1\n", r"t\.kitti: pose 2 is not 12 numbers"),
        (KITTI_LINE.format(0) + KITTI_LINE.format("inf"), "0\n1\n", r"t\.kitti: pose 2 is not made of finite numbers"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "0\n1\n", r"times\.txt: is not needed: t\.kitti is no KITTI file"),
    ],
)
def test_poses_and_times_that_do_not_fit_are_named(tmp_path: Path, text: str, times: str, problem: str) -> None:
    (tmp_path / "t.kitti").write_text(text)
    (tmp_path / "times.txt").write_text(times)
    with pytest.raises(DataError, match=problem):
        read_trajectory(tmp_path / "t.kitti", tmp_path / "times.txt")


def test_a_missing_file_of_times_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.kitti").write_text(2 * KITTI_LINE.format(0))
    with pytest.raises(DataError, match=r"missing\.tum: does not exist; check the path"):
        read_trajectory(tmp_path / "t.kitti", tmp_path / "missing.tum")


def test_a_tum_file_is_read_back_as_it_was_written(arc: Trajectory, tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", arc)
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(back.stamps_us, arc.stamps_us)
    np.testing.assert_allclose(back.poses[:, :2], arc.poses[:, :2], atol=5.1e-7)
    np.testing.assert_allclose(se2.wrap(back.poses[:, 2] - arc.poses[:, 2]), 0.0, atol=1e-8)


def test_evo_reads_the_tum_file(arc: Trajectory, tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(tmp_path / "t.tum", arc)
    track = file_interface.read_tum_trajectory_file(str(tmp_path / "t.tum"))
    np.testing.assert_allclose(track.timestamps, arc.stamps_us * 1e-6, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(track.positions_xyz[:, :2], arc.poses[:, :2], atol=5.1e-7)
    yaws = [np.arctan2(pose[1, 0], pose[0, 0]) for pose in track.poses_se3]
    np.testing.assert_allclose(se2.wrap(yaws - arc.poses[:, 2]), 0.0, atol=1e-8)


def test_comments_blank_lines_and_any_form_of_seconds_are_read(tmp_path: Path) -> None:
    file = tmp_path / "t.tum"
    file.write_text("# t x y z qx qy qz qw\n\n1 0 0 0 0 0 0 1\n1.5 1 2 9 0 0 1 0 # note\n2.25e0 2 0 0 0 0 -0.5 0.5\n")
    result = read_tum(file)
    assert result.stamps_us.tolist() == [1_000_000, 1_500_000, 2_250_000]
    np.testing.assert_allclose(result.poses, [[0, 0, 0], [1, 2, np.pi], [2, 0, -np.pi / 2]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "holds 0 poses"),
        ("1 0 0 0 0 0 0 1\n", "holds 1 pose;"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2 is not 't x y z qx qy qz qw' in finite numbers, as it has 7 words"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", r"give a TUM trajectory \(8 numbers per line, or 20, 29 or 44 with a cov"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 one\n", "line 2 is not made of finite numbers"),
        ("1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n", "line 2 is not made of finite numbers"),
        ("inf 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 1 is not made of finite numbers"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", "line 2 has a quaternion of zeros"),
        ("1 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "stamps do not increase at pose 3"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "stamps do not increase at pose 2"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused_by_name(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "t.tum"
    file.write_text(text)
    with pytest.raises(DataError, match=rf"t\.tum: .*{problem}"):
        read_tum(file)


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.5, 3.1])
def test_yaw_survives_roll_and_pitch(yaw: float) -> None:
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_euler("ZYX", [yaw, 0.2, -0.1]).as_quat()
    assert yaw_of_quaternion(*quaternion) == pytest.approx(yaw)
    assert yaw_of_quaternion(*(0.3 * quaternion)) == pytest.approx(yaw)


def test_poses_at_other_stamps_lie_on_the_arcs(arc: Trajectory) -> None:
    stamps = START_US + np.array([-100_000, 0, 100_000, 252_813, 700_000, 1_400_000])
    expected = se2.exp(np.tile([8.0, 0.1, 5.5], (6, 1)), (stamps - START_US) * 1e-6)
    np.testing.assert_allclose(arc.at(stamps), expected, atol=1e-9)


def test_the_length_is_that_of_the_path_not_of_the_way_home() -> None:
    there_and_back = Trajectory(np.arange(3), np.array([[0.0, 0, 0], [3.0, 4.0, 0], [0.0, 0, 0]]))
    assert there_and_back.length_m == 10.0 and len(there_and_back) == 3


@pytest.mark.parametrize(
    ("begin", "end", "covered"),
    [(0, 0, True), (-500_000, 0, True), (-500_001, 0, False), (0, 500_000, True), (0, 500_001, False)],
)
def test_half_a_second_may_be_missing_at_either_end(arc: Trajectory, begin: int, end: int, covered: bool) -> None:
    first, last = arc.stamps_us[[0, -1]].tolist()
    assert arc.covers(first + begin, last + end) is covered
