from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from mqslam.config import ReadingConfig
from mqslam.core import se2
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.lidars.carmen import read_lidar, recognises

SAMPLES = Path(__file__).parents[4] / "shared" / "data" / "carmen"


def flaser(t: float, pose: tuple[float, ...], ranges: list[float], robot: tuple[float, ...] | None = None) -> str:
    numbers = [len(ranges), *ranges, *pose, *(robot or pose), t]
    return "FLASER " + " ".join(f"{n:.17g}" for n in numbers) + f" host {t}\n"


def robotlaser(t: float, ranges: list[float], remissions: list[float], pose: tuple[float, ...]) -> str:
    numbers = [0, -2.0, 4.0, 0.5, 30.0, 0.01, 0, len(ranges), *ranges, len(remissions), *remissions]
    return "ROBOTLASER1 " + " ".join(map(str, [*numbers, *pose, *pose, 0, 0, 0, 0, 0, t])) + f" host {t}\n"


def odom(t: float, pose: tuple[float, ...]) -> str:
    return "ODOM " + " ".join(f"{n:.17g}" for n in [*pose, 0, 0, 0, t]) + f" host {t}\n"


def log(folder: Path, *lines: str) -> Path:
    path = folder / "drive.log"
    path.write_text("# message formats defined: PARAM ODOM FLASER\n" + "".join(lines))
    return path


def two_scans(*ranges: float) -> str:
    return flaser(1.0, (0, 0, 0), [*ranges]) + flaser(2.0, (1, 0, 0.1), [*ranges])


@pytest.mark.parametrize("count", [180, 181, 360, 361])
def test_the_beam_that_looks_straight_ahead_lies_a_quarter_turn_after_the_first(tmp_path: Path, count: int) -> None:
    readings = [81.91] * count
    readings[0], readings[90 * (count // 180)] = 3.0, 4.0
    recording = read_lidar(log(tmp_path, two_scans(*readings)))
    assert recording.format == "carmen"
    for scan in recording.scans:
        np.testing.assert_allclose(scan.returns.ranges, [3.0, 4.0])
        np.testing.assert_allclose(scan.returns.azimuths, [-np.pi / 2, 0.0], atol=1e-12)
        np.testing.assert_array_equal(scan.returns.intensities, [0.0, 0.0])


def test_scans_become_windows_with_poses_and_stamps(tmp_path: Path) -> None:
    scan = [2.0] * 180
    poses = [(0.0, 0.0, 0.0), (1.0, 0.5, 0.1), (2.0, 1.5, 0.2)]
    times = [1096000000.123456, 1096000001.123457, 1096000003.0]
    recording = read_lidar(log(tmp_path, *(flaser(t, p, scan) for t, p in zip(times, poses, strict=True))))
    np.testing.assert_allclose(recording.scans.stamps_us[1:] - recording.scans.stamps_us[0], [1_000_001, 2_876_544], atol=2)
    starts = [scan.t0 for scan in recording.scans]
    assert starts == pytest.approx([0.0, 1.000001, 2.876544], abs=2e-6)
    assert [scan.t1 for scan in recording.scans][:2] == starts[1:]
    for scan in recording.scans:
        assert np.all(scan.returns.times == scan.t0) and scan.t1 > scan.t0
    assert recording.trajectory is not None and recording.odometry is None
    np.testing.assert_array_equal(recording.trajectory.stamps_us, recording.scans.stamps_us)
    np.testing.assert_allclose(recording.trajectory.poses, poses)


def test_robotlaser_lines_say_their_angles_their_maximum_and_remissions(tmp_path: Path) -> None:
    lines = [robotlaser(t, [1.0, 30.0, 2.0], [7, 8, 9], (t, 0, 0)) for t in (1.0, 2.0)]
    recording = read_lidar(log(tmp_path, *lines))
    returns = recording.scans[0].returns
    np.testing.assert_allclose(returns.ranges, [1.0, 2.0])
    np.testing.assert_allclose(returns.azimuths, [-2.0, -1.0])
    np.testing.assert_allclose(returns.intensities, [7, 9])


def test_error_codes_zeros_and_what_is_no_number_are_no_returns(tmp_path: Path) -> None:
    readings = [81.83, 81.91, 0.0, -1.0, float("nan"), float("inf"), 5.0, 6.0]
    recording = read_lidar(log(tmp_path, two_scans(*readings)))
    np.testing.assert_allclose(recording.scans[0].returns.ranges, [5.0, 6.0])


def test_a_log_clipped_below_the_sensors_maximum_has_no_returns_there(tmp_path: Path) -> None:
    recording = read_lidar(log(tmp_path, two_scans(*([50.0] * 9), *np.linspace(3, 49, 171))))
    assert max(scan.returns.ranges.max() for scan in recording.scans) == 49.0
    assert any("50 m and above" in note for note in recording.notes)


@pytest.mark.parametrize(("named", "kept"), [("20.0", 2), ("2000", 2), ("3.5", 3), ("off", 3)])
def test_a_maximum_among_the_parameters_counts_where_no_range_is_longer(tmp_path: Path, named: str, kept: int) -> None:
    recording = read_lidar(
        log(
            tmp_path,
            f"PARAM robot_front_laser_max {named} nohost 0\n",
            flaser(1.0, (0, 0, 0), [5.0, 6.0, 20.0]),
            flaser(2.0, (0, 0, 0), [5.0, 6.0, 7.0]),
        )
    )
    assert len(recording.scans[0].returns) == kept


@pytest.mark.parametrize(("named", "offset"), [("0.25", 0.25), ("25", 0.25), ("0.0", 0.0)])
def test_odometry_is_carried_from_the_robot_to_the_lidar(tmp_path: Path, named: str, offset: float) -> None:
    recording = read_lidar(
        log(
            tmp_path,
            f"PARAM robot_frontlaser_offset {named} nohost 0\n",
            odom(0.5, (0, 0, np.pi / 2)),
            two_scans(*[2.0] * 180),
            odom(2.5, (0, 3, np.pi / 2)),
        )
    )
    assert recording.odometry is not None
    np.testing.assert_allclose(recording.odometry.poses, [[0, offset, np.pi / 2], [0, 3 + offset, np.pi / 2]], atol=1e-9)
    assert recording.odometry.stamps_us.tolist() == [500_000, 2_500_000]


def test_two_poses_that_are_rigidly_connected_show_where_the_lidar_sits(tmp_path: Path) -> None:
    robots = [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (1.5, 1.0, 2.0)]
    mount = (0.3, -0.1, 0.05)
    lines = [flaser(1.0 + k, tuple(se2.compose(r, mount)), [2.0] * 180, r) for k, r in enumerate(robots)]
    wheels = [odom(1.1 + k, r) for k, r in enumerate(robots)]
    recording = read_lidar(log(tmp_path, *lines, *wheels))
    assert recording.odometry is not None
    np.testing.assert_allclose(recording.odometry.poses, se2.compose(robots, mount), atol=1e-8)
    assert any("0.3 m, -0.1 m, 0.05 rad" in note for note in recording.notes)


def test_without_odom_lines_a_second_pose_that_differs_is_the_odometry(tmp_path: Path) -> None:
    lines = [flaser(k, (k, 0.1 * k, 0), [2.0] * 180, (1.1 * k, 0, 0.02 * k)) for k in range(4)]
    recording = read_lidar(log(tmp_path, *lines))
    assert recording.odometry is not None
    np.testing.assert_allclose(recording.odometry.poses, [(1.1 * k, 0, 0.02 * k) for k in range(4)], atol=1e-9)


def test_odometry_that_starts_anew_from_corrected_poses_is_chained(tmp_path: Path) -> None:
    """The way GMapping writes logs: after every scan the corrected pose as an ODOM line with a stamp of no meaning."""
    rng = np.random.default_rng(3)
    wheels = np.cumsum(rng.normal([0.3, 0.1, 0.1], 0.05, (31, 3)), axis=0)
    corrected = wheels + np.cumsum(rng.normal(0, 0.05, (31, 3)), axis=0)
    lines, anchor, at = [odom(0.0, tuple(wheels[0]))], wheels[0], wheels[0]
    for k in range(1, 31):
        lines.append(odom(float(k), tuple(se2.compose(anchor, se2.between(at, wheels[k])))))
        if k % 3 == 0:
            lines.append(flaser(float(k), tuple(corrected[k]), [2.0] * 180))
            lines.append(odom((0.0, 1.08e-42, 1.13)[k % 9 // 3], tuple(corrected[k])))
            anchor, at = corrected[k], wheels[k]
    recording = read_lidar(log(tmp_path, *lines))
    assert recording.odometry is not None and recording.trajectory is not None
    np.testing.assert_array_equal(recording.odometry.stamps_us, np.arange(31) * 1_000_000)
    np.testing.assert_allclose(recording.odometry.poses, wheels, atol=1e-6)
    np.testing.assert_allclose(recording.trajectory.poses, corrected[3::3], atol=1e-6)
    assert any("reset to a corrected pose 10 times" in note for note in recording.notes)


def test_stray_stamps_cost_their_own_lines_and_no_others(tmp_path: Path) -> None:
    scans = [flaser(t, (k, 0, 0), [2.0] * 180) for k, t in enumerate([1.0, 900.0, 2.0, 2.0, 3.0])]
    wheels = [odom(t, (t, 0, 0)) for t in (1.0, 1.5, 1.4, 2.0, 2.0, 3.0)]
    recording = read_lidar(log(tmp_path, *scans, *wheels))
    assert recording.scans.stamps_us.tolist() == [1_000_000, 2_000_000, 3_000_000]
    assert recording.odometry is not None and len(recording.odometry) == 4
    assert any(note.startswith("2 scans") for note in recording.notes)
    assert any(note.startswith("2 of 6 odometry poses") for note in recording.notes)


def test_the_odometry_written_with_a_scan_stays_where_stamps_run_to_and_fro(tmp_path: Path) -> None:
    recording = read_lidar(
        log(
            tmp_path,
            odom(1.0, (0, 0, 0)),
            flaser(1.0, (0, 0, 0), [2.0] * 180),
            *(odom(t, (t, 0, 0)) for t in (2.3, 2.4, 2.5, 2.0)),
            flaser(2.0, (5, 0, 0), [2.0] * 180),
            odom(3.0, (3, 0, 0)),
        )
    )
    assert recording.odometry is not None
    assert recording.odometry.stamps_us.tolist() == [1_000_000, 2_000_000, 3_000_000]


def test_poses_that_are_the_odometrys_own_are_noted(tmp_path: Path) -> None:
    poses = [(0.5 * k, 0.0, 0.1 * k) for k in range(5)]
    scans = [flaser(k, p, [2.0] * 180) + odom(k + 1e-3, p) for k, p in enumerate(poses)]
    assert any("no SLAM system has corrected them" in note for note in read_lidar(log(tmp_path, *scans)).notes)


def test_scans_of_a_rear_lidar_are_left_out_with_a_note(tmp_path: Path) -> None:
    rear = two_scans(*[3.0] * 180).replace("FLASER", "RLASER")
    recording = read_lidar(log(tmp_path, two_scans(*[2.0] * 180), rear))
    assert len(recording.scans) == 2 and any("2 RLASER" in note for note in recording.notes)


def test_compressed_logs_are_read_whatever_they_are_called(tmp_path: Path) -> None:
    plain = log(tmp_path, two_scans(*[2.0] * 180))
    packed = tmp_path / "packed.log.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    renamed = tmp_path / "renamed.clf"
    renamed.write_bytes(packed.read_bytes())
    for path in (plain, packed, renamed):
        assert recognises(path) and len(read_lidar(path).scans) == 2
    assert not recognises(tmp_path / "missing.log") and not recognises(tmp_path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", r"holds 0 scans .*messages: none"),
        ("ODOM 0 0 0 0 0 0 1 host 1\n", r"holds 0 scans .*messages: 1 ODOM"),
        (two_scans(2.0).split("\n")[0] + "\n", "holds 1 scan with"),
        ("FLASER 180 1 2 3\n", "line 1 is not a complete FLASER message"),
        ("FLASER 99999999999 1 2 3\n", "line 1 is not a complete FLASER message"),
        ("FLASER -3 1 2 3 4 5 6 7 8 9 10\n", "line 1 is not a complete FLASER message"),
        ("FLASER\n", "line 1 is not a complete FLASER message"),
        ("FLASER 2 1 x 0 0 0 0 0 0 1 host 1\n", "line 1 is not a complete FLASER message"),
        ("FLASER 2 1 2 0 0 nan 0 0 0 1 host 1\n", "line 1 is not a complete FLASER message"),
        ("FLASER 2 1 2 0 0 0 0 0 0 host 1\n", "line 1 is not a complete FLASER message"),
        ("ROBOTLASER1 0 -1.5 3.1 0.1 30 0.01 0 3 1 2 3 900 0 0\n", "line 1 is not a complete ROBOTLASER1 message"),
        (two_scans(2.0) + "ODOM 0 0\n", "line 3 is not a complete ODOM message"),
        (two_scans(2.0).replace(" 1 host", " nan host"), "holds stamps that are not finite"),
        (two_scans(2.0).replace(" 1 host", " 1e300 host"), "holds stamps too large for any clock"),
        (two_scans(81.91, 0.0), "holds no range below the lidar's maximum"),
        ("1 " * 600_000, "line 1 is longer than a line of numbers can be"),
    ],
)
def test_a_log_that_cannot_be_used_is_named_in_one_line(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "drive.log"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"drive\.log: {problem}") as raised:
        read_lidar(path)
    assert "\n" not in str(raised.value)


def test_damaged_compression_and_noise_are_named(tmp_path: Path) -> None:
    packed = gzip.compress(two_scans(*np.random.default_rng(0).uniform(1, 9, 180)).encode())
    for k, content in enumerate([packed[: len(packed) // 2], packed[:400] + b"\0" * 200 + packed[600:], packed[:8]]):
        path = tmp_path / f"damaged{k}.log.gz"
        path.write_bytes(content)
        with pytest.raises(DataError, match=rf"damaged{k}\.log\.gz: is not a readable log"):
            read_lidar(path)
    noise = tmp_path / "noise.log"
    noise.write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(DataError, match=r"noise\.log: holds 0 scans"):
        read_lidar(noise)
    with pytest.raises(DataError, match=r"missing\.log: is not a readable log"):
        read_lidar(tmp_path / "missing.log")


def spread(trajectory: Trajectory, scans: Scans) -> float:
    """Returns the median distance [m] from a return to the nearest one measured over twenty scans before or after."""
    from scipy.spatial import cKDTree

    places, owners = [], []
    for k, (pose, scan) in enumerate(zip(trajectory.poses, scans, strict=True)):
        near = scan.returns.ranges < 15.0
        r, a = scan.returns.ranges[near], scan.returns.azimuths[near]
        places.append(se2.transform(pose, np.column_stack([r * np.cos(a), r * np.sin(a)])))
        owners.append(np.full(len(r), k))
    points, owner = np.concatenate(places), np.concatenate(owners)
    distances, neighbours = cKDTree(points).query(points[::11], k=40)
    distances[np.abs(owner[neighbours] - owner[::11, None]) <= 20] = np.inf
    nearest = distances.min(axis=1)
    return float(np.median(nearest[np.isfinite(nearest)]))


@pytest.mark.parametrize(("name", "scans", "drift"), [("intel", 906, 61.75), ("aces", 440, 18.07)])
def test_real_logs_make_a_sharp_map_under_their_poses_and_none_under_the_odometry(
    name: str, scans: int, drift: float
) -> None:
    path = SAMPLES / f"{name}-corrected.log.gz"
    if not path.exists():
        pytest.skip(f"the real sample is not at {path}")
    recording = read_lidar(path)
    trajectory, odometry = recording.trajectory, recording.odometry
    assert trajectory is not None and odometry is not None and len(recording.scans) == scans
    assert max(scan.returns.ranges.max() for scan in recording.scans) < 50.0
    raw = Trajectory(trajectory.stamps_us, odometry.at(trajectory.stamps_us))
    one, other = (se2.between(poses[0], poses) for poses in (trajectory.poses, raw.poses))
    apart = np.hypot(*se2.between(one, other)[:, :2].T)
    assert apart.max() == pytest.approx(drift, abs=0.01)
    assert spread(trajectory, recording.scans) < 0.04 < spread(raw, recording.scans)


HOKUYO = np.linspace(1.0, 4.0, 682)


def test_scans_of_other_lidars_are_refused_until_their_field_of_view_is_stated(tmp_path: Path) -> None:
    path = log(tmp_path, two_scans(*HOKUYO))
    with pytest.raises(DataError, match=r"scans of 682 readings, and does not say what angle they sweep; .*lidar_fov_deg"):
        read_lidar(path)
    recording = read_lidar(path, ReadingConfig(lidar_fov_deg=240.0))
    angles = recording.scans[0].returns.azimuths
    np.testing.assert_allclose(np.degrees(angles[[0, -1]]), [-120.0, 120.0])
    assert "the readings of a scan sweep 240 degrees, as reading.lidar_fov_deg states it" in recording.notes


@pytest.mark.parametrize("name", ["laser_front_laser_fov", "laser_laser1_fov"])
def test_the_field_of_view_among_the_parameters_counts(tmp_path: Path, name: str) -> None:
    recording = read_lidar(log(tmp_path, f"PARAM {name} 240.0 1 host 1\n", two_scans(*HOKUYO)))
    np.testing.assert_allclose(np.degrees(recording.scans[1].returns.azimuths[[0, -1]]), [-120.0, 120.0])
    assert f"the readings of a scan sweep 240 degrees, as {name} states it" in recording.notes


def test_a_lidar_that_looks_all_around_sees_no_direction_twice(tmp_path: Path) -> None:
    recording = read_lidar(log(tmp_path, two_scans(*HOKUYO[:360])), ReadingConfig(lidar_fov_deg=360.0))
    np.testing.assert_allclose(np.degrees(recording.scans[0].returns.azimuths), np.arange(-180.0, 180.0), atol=1e-9)


def test_a_robotlaser_line_without_a_resolution_has_its_field_of_view(tmp_path: Path) -> None:
    lines = [robotlaser(t, [*np.arange(1.0, 10.0)], [], (t, 0, 0)).replace(" 4.0 0.5 ", " 4.0 0 ") for t in (1.0, 2.0)]
    azimuths = read_lidar(log(tmp_path, *lines)).scans[0].returns.azimuths
    np.testing.assert_allclose(azimuths, np.linspace(-2.0, 2.0, 9))
    with pytest.raises(DataError, match="line 2 is not a complete ROBOTLASER1 message"):
        read_lidar(log(tmp_path, *(line.replace(" 4.0 0 ", " 0 0 ") for line in lines)))
