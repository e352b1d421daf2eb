"""Trajectories keep their stamps to the microsecond and their poses to the micrometre through files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.poses import yaw_of_quaternion
from mqslam.formats.tum import read_tum, write_tum

START_US = 1_547_131_046_353_776


@pytest.fixture
def arc() -> Trajectory:
    """A drive over more than a turn, with uneven stamps, one of them a few milliseconds after a full second."""
    stamps = START_US + np.array([0, 252_813, 504_787, 650_000, 1_002_755, 1_251_173])
    twists = np.tile([8.0, 0.1, 5.5], (6, 1))
    return Trajectory(stamps, se2.exp(twists, (stamps - START_US) * 1e-6))


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
        ("1 0 0 0 0 0 0 1\n", "holds 1 poses"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2 is not"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 one\n", "line 2 is not"),
        ("1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n", "line 2 is not"),
        ("inf 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 1 is not"),
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


def test_a_file_that_is_no_text_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_bytes(b"\xff\xfe\x00\x81")
    for name, problem in (("t.tum", "is not a readable text file"), ("other.txt", "does not exist")):
        with pytest.raises(DataError, match=f"{name}: {problem}"):
            read_tum(tmp_path / name)


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
