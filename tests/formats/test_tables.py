"""Units in the names of columns, seconds with nanoseconds, and byte order marks, in every table that is read."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import START_US
from support.sensors import write_lines

from mqslam.config.yaml_file import parse_tree
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.clouds import read_cloud
from mqslam.formats.graphs.g2o import read_g2o
from mqslam.formats.lidars.carmen import read_lidar
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.radiate import read_listing
from mqslam.formats.sensors import read_fixes, read_gyroscope
from mqslam.formats.sensors.csv_files import read_transform
from mqslam.formats.trajectories import read_odometry, read_trajectory

YAW = 0.5
STAMPS = START_US + 250_000 * np.arange(4)


def read(path: Path, header: str, cells: str) -> Trajectory:
    """Returns the trajectory of a table with the same cells in every row, {t} or {s} and {n} for the stamp."""
    rows = [cells.format(t=t, s=t // 10**6, n=t % 10**6 * 1000, l=t * 1000) for t in STAMPS.tolist()]
    return read_trajectory(write_lines(path / "poses.csv", header, *rows))


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("t,x,y,yaw [deg]", 180.0 / np.pi),
        ("t,x,y,heading(deg)", 180.0 / np.pi),
        ("t,x,y,Theta (degrees)", 180.0 / np.pi),
        ("t,x,y,yaw_deg", 180.0 / np.pi),
        ("t,x,y,yaw [rad]", 1.0),
        ("t,x,y,yaw_rad", 1.0),
    ],
)
def test_a_unit_of_the_yaw_is_converted(tmp_path: Path, header: str, scale: float) -> None:
    track = read(tmp_path, header, f"{{t}},1,2,{scale * YAW:.12f}")
    np.testing.assert_allclose(track.poses, [[1.0, 2.0, YAW]] * 4)


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("t,x [mm],y [mm],yaw", 1e3),
        ("t,x_mm,y_mm,yaw", 1e3),
        ("t,x (km),y (km),yaw", 1e-3),
        ("t,x [m],y position [m],yaw", 1),
    ],
)
def test_units_of_places_are_converted(tmp_path: Path, header: str, scale: float) -> None:
    track = read(tmp_path, header, f"{{t}},{scale},{2 * scale},{YAW}")
    np.testing.assert_allclose(track.poses, [[1.0, 2.0, YAW]] * 4)


def test_a_unit_that_cannot_be_converted_is_refused_by_the_columns_name(tmp_path: Path) -> None:
    for header, column in (("t,x,y,yaw [gon]", "yaw [gon]"), ("t,x [furlong],y,yaw", "x [furlong]")):
        with pytest.raises(DataError) as error:
            read(tmp_path, header, "{t},1,2,0")
        assert f"column {column} states a unit" in str(error.value)


def test_columns_of_quaternions_may_state_that_they_have_no_unit(tmp_path: Path) -> None:
    cells = f"{{t}},1,2,0,0,{np.sin(YAW / 2.0):.12f},{np.cos(YAW / 2.0):.12f}"
    track = read(tmp_path, "t,x,y,qx [-],qy (-),qz[-],qw", cells)
    np.testing.assert_allclose(track.poses, [[1.0, 2.0, YAW]] * 4)
    with pytest.raises(DataError, match=r"column qx \[rad\] states a unit .*; leave the unit out"):
        read(tmp_path, "t,x,y,qx [rad],qy,qz,qw", cells)


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("timestamp_sec,timestamp_nsec,x,y,yaw", "{s},{n},1,2,0.5"),
        ("stamp_sec,stamp_nsec,x,y,yaw", "{s},{n},1,2,0.5"),
        ("header.stamp.sec,header.stamp.nanosec,x,y,yaw", "{s},{n},1,2,0.5"),
        ("sec,nanosec,x,y,yaw", "{s},{n},1,2,0.5"),
        ("x,y,yaw,nsecs,secs", "1,2,0.5,{n},{s}"),
        ("time_s,time_ns,x,y,yaw", "{s},{l},1,2,0.5"),
    ],
)
def test_seconds_and_nanoseconds_are_joined(tmp_path: Path, header: str, cells: str) -> None:
    track = read(tmp_path, header, cells)
    np.testing.assert_array_equal(track.stamps_us, STAMPS)
    np.testing.assert_allclose(track.poses, [[1.0, 2.0, YAW]] * 4)


def test_nanoseconds_that_are_no_whole_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nanoseconds that are no whole numbers"):
        read(tmp_path, "sec,nsec,x,y,yaw", "{s},0.5,1,2,0.5")


def test_clouds_join_seconds_and_nanoseconds(tmp_path: Path) -> None:
    xy = np.arange(4.0)
    whole, parts = (STAMPS // 10**6).astype(np.int32), (STAMPS % 10**6 * 1000).astype(np.int32)
    np.savez(tmp_path / "cloud.npz", x=xy, y=xy, timestamp_sec=whole, timestamp_nsec=parts)
    cloud = read_cloud(tmp_path / "cloud.npz")
    np.testing.assert_array_equal(cloud.stamps_us, STAMPS)
    assert any("timestamp_sec and timestamp_nsec, in ns" in note for note in cloud.notes)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("t,v [km/h],omega [deg/s]", "{t},36,{degrees}"),
        ("time [ns],v_mps,omega_rad_s", "{l},10,{radians}"),
        ("t,v [m / s],omega [rad / s]", "{t},10,{radians}"),
        ("sec,nsec,v,omega (dps)", "{s},{n},10,{degrees}"),
        ("\ufefft,v,omega", "{t},10,{radians}"),
    ],
)
def test_odometry_converts_what_its_header_states(tmp_path: Path, header: str, row: str) -> None:
    told = {"degrees": f"{np.degrees(0.2):.12f}", "radians": "0.2"}
    rows = [row.format(t=t, s=t // 10**6, n=t % 10**6 * 1000, l=t * 1000, **told) for t in STAMPS.tolist()]
    track = read_odometry(write_lines(tmp_path / "odom.csv", header, *rows))
    np.testing.assert_array_equal(track.stamps_us, STAMPS)
    np.testing.assert_allclose(track.mean_twists(STAMPS[:1], STAMPS[1:2]), [[10.0, 0.0, 0.2]], atol=1e-9)


def test_odometry_in_seconds_without_a_unit_is_told_its_unit(tmp_path: Path) -> None:
    rows = [f"16000000{k / 20:05.2f},10,0" for k in range(4)]
    with pytest.raises(DataError, match=r"holds fractions, but is taken for microseconds; name its unit .* such as t \[s\]"):
        read_odometry(write_lines(tmp_path / "odom.csv", "t,v,omega", *rows))
    track = read_odometry(write_lines(tmp_path / "odom.csv", "t [s],v,omega", *rows))
    assert np.diff(track.stamps_us).tolist() == [50_000] * 3


def test_a_table_of_poses_is_odometry_too(tmp_path: Path) -> None:
    rows = [f"{t // 10**6},{t % 10**6 * 1000},{1e3 * k},{-2e3 * k},{0.5 * k}" for k, t in enumerate(STAMPS.tolist())]
    track = read_odometry(write_lines(tmp_path / "odom.csv", "stamp_sec,stamp_nsec,x [mm],y [mm],yaw [deg]", *rows))
    np.testing.assert_array_equal(track.stamps_us, STAMPS)
    k = np.arange(len(STAMPS))
    np.testing.assert_allclose(track.poses, np.column_stack([k, -2.0 * k, np.radians(0.5 * k)]), atol=1e-9)


@pytest.mark.parametrize(
    ("header", "problem"), [("t,a,b", "has no column v, omega (columns: t, a, b)"), ("t,v,b", "has no column omega")]
)
def test_odometry_without_its_columns_is_refused_with_what_it_has(tmp_path: Path, header: str, problem: str) -> None:
    with pytest.raises(DataError, match=re.escape(problem)):
        read_odometry(write_lines(tmp_path / "odom.csv", header, "0,1,2", "1000000,1,2"))


def test_sensors_convert_what_their_headers_state(tmp_path: Path) -> None:
    rows = [f"{t // 10**6},{t % 10**6 * 1000},1,2,{k}" for k, t in enumerate(STAMPS.tolist())]
    header = "timestamp_sec,timestamp_nsec,wx [deg/s],wy [deg/s],wz [deg/s]"
    gyroscope = read_gyroscope(write_lines(tmp_path / "imu.csv", header, *rows)).sensor
    np.testing.assert_array_equal(gyroscope.stamps_us, STAMPS)
    np.testing.assert_allclose(gyroscope.rates[3], np.radians([1.0, 2.0, 3.0]))
    rows = [f"{t / 1e6},0.9,{0.1 + 1e-6 * k}" for k, t in enumerate(STAMPS.tolist())]
    fixes = read_fixes(write_lines(tmp_path / "gnss.csv", "t [s],lat [rad],lon [rad]", *rows), START_US).sensor
    np.testing.assert_array_equal(fixes.stamps_us, STAMPS)
    np.testing.assert_allclose(fixes.latitudes, np.degrees(0.9))


MARK = b"\xef\xbb\xbf"
POSES = "".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(3))
SCANS = "".join(f"FLASER 180 {' '.join(str(1 + k / 180) for k in range(180))} {t} 0 0 {t} 0 0 {t} h {t}\n" for t in (1, 2))
GRAPH = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("a.tum", POSES, lambda path: read_trajectory(path).poses),
        ("a.tum", POSES, lambda path: read_odometry(path).poses),
        ("a.csv", "t,v,omega\n0,1,0\n1000000,1,0\n", lambda path: read_odometry(path).poses),
        ("a.csv", "t,x,y,yaw\n0,1,0,0\n1000000,2,0,0\n", lambda path: read_trajectory(path).poses),
        ("a.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", read_transform),
        ("a.txt", "Frame: 000001 Time: 1574859771.744660272\n", lambda path: read_listing(path)[1]),
        ("a.g2o", GRAPH, lambda path: np.array(read_g2o(path).keys)),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_changes_nothing(tmp_path: Path, encoding: str, name: str, text: str, read: Callable[[Path], Any]) -> None:
    plain, marked = tmp_path / f"plain_{name}", tmp_path / f"marked_{name}"
    plain.write_text(text)
    marked.write_bytes(text.encode(encoding))
    np.testing.assert_array_equal(read(marked), read(plain))


@pytest.mark.parametrize(("name", "pack"), [("a.log", bytes), ("a.log.gz", gzip.compress)])
def test_a_mark_in_a_carmen_log_changes_nothing(tmp_path: Path, name: str, pack: Callable[[bytes], bytes]) -> None:
    (tmp_path / name).write_bytes(pack(MARK + SCANS.encode()))
    assert len(read_lidar(tmp_path / name).scans) == 2


def test_a_mark_in_settings_changes_nothing() -> None:
    text = "sensor: {clockwise: false}\n"
    assert parse_tree("a.yaml", MARK + text.encode()) == parse_tree("a.yaml", text)


def test_a_mark_before_the_stamps_of_images_changes_nothing(oxford: Path) -> None:
    listing = oxford / "radar.timestamps"
    plain = open_recording(oxford)
    listing.write_bytes(MARK + listing.read_bytes())
    marked = open_recording(oxford)
    np.testing.assert_array_equal(marked.stamps_us, plain.stamps_us)
    assert marked.faults == plain.faults


@pytest.mark.parametrize("per_s", [1e3, 1e6, 1e9])
def test_stamps_of_tum_files_in_other_units_than_seconds_are_read(tmp_path: Path, per_s: float) -> None:
    (tmp_path / "a.tum").write_text("".join(f"{int((1.7e9 + 0.25 * k) * per_s)} {k} 0 0 0 0 0 1\n" for k in range(3)))
    for read in (read_trajectory, read_odometry):
        np.testing.assert_array_equal(read(tmp_path / "a.tum").stamps_us, 1_700_000_000_000_000 + 250_000 * np.arange(3))
