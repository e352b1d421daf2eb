"""Clouds with a time per point, as our own maps and other software write them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from plyfile import PlyData

from mqslam.core.point_map import PointMap
from mqslam.errors import DataError, OutputError
from mqslam.formats.clouds import read_cloud
from mqslam.formats.ply import MapClock, read_clock, write_ply

START_US = 1_547_131_046_353_776
X = np.array([3.0, 1.0, 2.0, 5.0])
Y = np.array([-1.0, -2.0, -3.0, -4.0])
Z = np.array([0.0, 0.5, 1.0, 9.0])
T = np.array([2.0, 0.25, 1.0, 3.5])
ORDER = [1, 2, 0, 3]


def ply(path: Path, kind: str, values: NDArray[Any], body: str = "ascii") -> Path:
    """Writes by hand a PLY with x, y and z as double, and a time of a kind."""
    properties = "".join(f"property double {name}\n" for name in "xyz")
    header = f"ply\nformat {body} 1.0\nelement vertex {len(values)}\n{properties}property {kind} time\nend_header\n"
    types = {"float": "f4", "double": "f8", "int": "i4", "uint": "u4", "ushort": "u2"}
    order = ">" if "big" in body else "<"
    table = np.zeros(len(values), [(name, f"{order}f8") for name in "xyz"] + [("time", order + types[kind])])
    table["x"], table["y"], table["z"], table["time"] = X[: len(values)], Y[: len(values)], Z[: len(values)], values
    rows = "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in table.tolist()).encode()
    path.write_bytes(header.encode() + (rows if body == "ascii" else table.tobytes()))
    return path


def pcd(path: Path, kind: str, values: NDArray[Any], data: str = "binary") -> Path:
    """Writes a PCD the way PCL does: with padding between z and the time."""
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z _ t\nSIZE 4 4 4 1 8\n"
        f"TYPE F F F U {kind}\nCOUNT 1 1 1 4 1\nWIDTH {len(values)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(values)}\nDATA {data}\n"
    )
    stamp = {"F": "<f8", "U": "<u8"}[kind]
    table = np.zeros(len(values), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("_", "u1", 4), ("t", stamp)])
    table["x"], table["y"], table["z"], table["t"] = X, Y, Z, values
    rows = [f"{x:g} {y:g} {z:g} 0 0 0 0 {t!r}\n" for x, y, z, t in zip(X, Y, Z, values.tolist(), strict=True)]
    path.write_bytes(header.encode() + ("".join(rows).encode() if data == "ascii" else table.tobytes()))
    return path


def las(path: Path, point_format: int = 1) -> Path:
    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 5_000_000.0, 0.0]
    content = laspy.LasData(header)
    content.x, content.y, content.z = 400_000.0 + X, 5_000_000.0 + Y, Z
    if point_format:
        content.gps_time = 250_000.0 + T
    content.write(str(path))
    return path


@pytest.mark.parametrize("body", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(("kind", "values"), [("float", T), ("double", T + 1.6e9), ("uint", 4 * T), ("ushort", 4 * T)])
def test_ply_clouds_come_in_the_order_of_their_times(tmp_path: Path, body: str, kind: str, values: NDArray[Any]) -> None:
    cloud = read_cloud(ply(tmp_path / "map.ply", kind, values, body))
    np.testing.assert_array_equal(cloud.points, np.column_stack([X, Y])[ORDER])
    np.testing.assert_array_equal(cloud.stamps_us, np.round(values[ORDER] * 1e6))
    assert cloud.points.dtype == np.float64 and cloud.stamps_us.dtype == np.int64
    assert "times are read from time, in s" in cloud.notes


def test_the_map_of_a_run_is_read_as_open3d_reads_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    places, times = rng.uniform(-100, 100, (500, 2)), np.sort(rng.uniform(0, 600, 500))
    zeros = np.zeros(500)
    write_ply(tmp_path / "map.ply", PointMap(places, times, zeros, zeros, zeros > 0), MapClock(START_US, 250_000))
    cloud = read_cloud(tmp_path / "map.ply")
    other = o3d.t.io.read_point_cloud(str(tmp_path / "map.ply"))
    np.testing.assert_array_equal(cloud.points, other.point["positions"].numpy()[:, :2])
    np.testing.assert_array_equal(cloud.stamps_us, np.round(other.point["time"].numpy()[:, 0] * 1e6))
    np.testing.assert_allclose(cloud.stamps_us - START_US, times * 1e6, atol=1.0)
    assert cloud.scan_us == 250_000
    old = (tmp_path / "map.ply").read_bytes().replace(b"since 0 us", b"since 1547131046353776 us")
    (tmp_path / "map.ply").write_bytes(old)
    np.testing.assert_array_equal(read_cloud(tmp_path / "map.ply").stamps_us, cloud.stamps_us + START_US)
    (tmp_path / "map.ply").write_bytes(old.replace(b"1547131046353776", b"4611686018427387904"))
    with pytest.raises(DataError, match="beyond any clock"):
        read_cloud(tmp_path / "map.ply")


@pytest.mark.parametrize("data", ["ascii", "binary"])
@pytest.mark.parametrize(
    ("kind", "values", "unit"),
    [
        ("F", T, "s"),
        ("U", (START_US + np.round(T * 1e6).astype(np.uint64)).astype(np.uint64), "us"),
        ("U", (START_US * 1000 + np.round(T * 1e9).astype(np.uint64)).astype(np.uint64), "ns"),
    ],
)
def test_pcd_clouds_with_padding_keep_stamps_to_the_microsecond(
    tmp_path: Path, data: str, kind: str, values: NDArray[Any], unit: str
) -> None:
    cloud = read_cloud(pcd(tmp_path / "map.pcd", kind, values, data))
    start = 0 if unit == "s" else START_US
    np.testing.assert_array_equal(cloud.points, np.column_stack([X, Y])[ORDER])
    np.testing.assert_array_equal(cloud.stamps_us, start + np.round(T[ORDER] * 1e6).astype(np.int64))
    assert f"times are read from t, in {unit}" in cloud.notes


@pytest.mark.parametrize("compressed", [True, False])
def test_pcd_clouds_that_open3d_writes_are_read(tmp_path: Path, compressed: bool) -> None:
    rng = np.random.default_rng(0)
    places, times = rng.uniform(-9, 9, (300, 3)).astype(np.float32), np.round(np.sort(rng.uniform(0, 60, 300)), 3)
    written = o3d.t.geometry.PointCloud()
    written.point["positions"], written.point["time"] = o3d.core.Tensor(places), o3d.core.Tensor(times[:, None])
    o3d.t.io.write_point_cloud(str(tmp_path / "map.pcd"), written, compressed=compressed)
    cloud = read_cloud(tmp_path / "map.pcd")
    np.testing.assert_array_equal(cloud.points, places[:, :2])
    np.testing.assert_array_equal(cloud.stamps_us, np.round(times * 1e6))


@pytest.mark.parametrize("name", ["map.las", "map.laz"])
@pytest.mark.parametrize("point_format", [1, 6])
def test_las_clouds_are_read_to_their_own_precision(tmp_path: Path, name: str, point_format: int) -> None:
    cloud = read_cloud(las(tmp_path / name, point_format))
    np.testing.assert_allclose(cloud.points, np.column_stack([4e5 + X, 5e6 + Y])[ORDER], atol=1e-9)
    np.testing.assert_array_equal(cloud.stamps_us, np.round((250_000 + T[ORDER]) * 1e6))


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": X, "y": Y, "t": T},
        {"points": np.column_stack([X, Y]), "times": T},
        {"points": np.column_stack([X, Y, Z]).astype(np.float32), "stamps": T},
        {"x": X, "y": Y, "stamps_us": (T * 1e6).astype(np.int64)},
        {"x": X, "y": Y, "t_ms": T * 1e3, "colours": np.zeros((9, 9))},
    ],
)
def test_npz_clouds_are_read_from_columns_or_points(tmp_path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    np.savez(tmp_path / "map.npz", **arrays)
    cloud = read_cloud(tmp_path / "map.npz")
    np.testing.assert_array_equal(cloud.points, np.column_stack([X, Y])[ORDER])
    np.testing.assert_array_equal(cloud.stamps_us, np.round(T[ORDER] * 1e6))


@pytest.mark.parametrize("name", ["map.ply", "map.pcd", "map.las", "map.npz"])
def test_a_range_of_z_cuts_a_slice(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "map.ply":
        ply(path, "double", T)
    elif name == "map.pcd":
        pcd(path, "F", T)
    elif name == "map.las":
        las(path)
    else:
        np.savez(path, points=np.column_stack([X, Y, Z]), t=T)
    whole, cut = read_cloud(path), read_cloud(path, z_range=(0.5, 2.0))
    np.testing.assert_array_equal(cut.points, whole.points[:2])
    assert any("2 of 4 points" in note for note in cut.notes)


def test_points_that_are_not_finite_are_left_out_with_a_note(tmp_path: Path) -> None:
    broken = {"x": [*X, np.nan, 1, 1], "y": [*Y, 1, np.inf, 1], "t": [*T, 1, 1, np.nan]}
    np.savez(tmp_path / "map.npz", **{name: np.array(values) for name, values in broken.items()})
    cloud = read_cloud(tmp_path / "map.npz")
    assert len(cloud) == 4 and "3 points without finite coordinates and time: left out" in cloud.notes


def test_times_too_coarse_for_single_precision_are_noted_or_refused(tmp_path: Path) -> None:
    assert not any("single" in note for note in read_cloud(ply(tmp_path / "a.ply", "float", T)).notes)
    noted = read_cloud(ply(tmp_path / "b.ply", "float", T + 20_000)).notes
    assert any("steps of 0.002 s" in note for note in noted)
    with pytest.raises(DataError, match=r"c\.ply: time is single-precision, .* 128 s apart"):
        read_cloud(ply(tmp_path / "c.ply", "float", T + 1.6e9))


@pytest.mark.parametrize(
    ("name", "start", "unit_us", "step"),
    [("t_us", 4e8, 1, ""), ("t_ms", 2e7, 1000, "times come in steps of 0.002 s"), ("t_ns", 4e11, 1e-3, "")],
)
def test_coarse_times_are_so_in_their_own_unit(tmp_path: Path, name: str, start: float, unit_us: float, step: str) -> None:
    times = (start + 1e6 * T / unit_us).astype(np.float32)
    np.savez(tmp_path / "map.npz", x=X, y=Y, **{name: times})
    cloud = read_cloud(tmp_path / "map.npz")
    np.testing.assert_allclose(cloud.stamps_us, np.sort(times.astype(np.float64) * unit_us), rtol=0.0, atol=1.0)
    assert [note for note in cloud.notes if "single" in note] == ([f"{name} is single-precision: {step}"] if step else [])


def test_steps_of_single_precision_times_since_1970_are_refused_in_any_unit(tmp_path: Path) -> None:
    for name, scale in (("t", 1e6), ("t_us", 1e6), ("t_ns", 1e9)):
        np.savez(tmp_path / "map.npz", x=X, y=Y, **{name: ((T + 1.6e9) * scale).astype(np.float32)})
        with pytest.raises(DataError, match=r"different times are at least 13[47] s apart"):
            read_cloud(tmp_path / "map.npz")


def test_times_that_no_drive_has_are_refused(tmp_path: Path) -> None:
    for times, is_read in (([0.0, *1.7e9 + np.arange(40.0)], True), (np.linspace(-1e9, 1e9, 41), False)):
        np.savez(tmp_path / "cloud.npz", x=np.zeros(41), y=np.zeros(41), t=np.asarray(times))
        if is_read:
            assert len(read_cloud(tmp_path / "cloud.npz")) == 41
        else:
            with pytest.raises(DataError, match="t spans 57 years"):
                read_cloud(tmp_path / "cloud.npz")


def test_a_cloud_without_times_is_refused_with_its_fields(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.column_stack([X, Y]), colours=X)
    np.savez(tmp_path / "b.npz", x=X, t=T)
    las(tmp_path / "c.las", point_format=0)
    untimed = ply(tmp_path / "d.ply", "double", T).read_bytes().replace(b"double time", b"double flux")
    (tmp_path / "d.ply").write_bytes(untimed)
    for name, problem in [
        ("a.npz", r"has no time per point \(fields: x, y, points, colours\)"),
        ("b.npz", r"has no x and y \(fields: x, t\)"),
        ("c.las", r"has no time per point \(fields: x, y, z, intensity, .*"),
        ("d.ply", r"has no time per point \(fields: x, y, z, flux\)"),
    ]:
        with pytest.raises(DataError, match=rf"{name}: {problem}; a cloud needs x, y and one of time, t"):
            read_cloud(tmp_path / name)


def damaged(tmp_path: Path) -> dict[str, bytes]:
    """Returns files that claim what they do not hold."""
    text = ply(tmp_path / "whole.ply", "double", T).read_bytes()
    packed = ply(tmp_path / "whole.ply", "double", T, "binary_little_endian").read_bytes()
    padded = pcd(tmp_path / "whole.pcd", "F", T).read_bytes()
    written = pcd(tmp_path / "whole.pcd", "F", T, "ascii").read_bytes()
    survey, zipped = las(tmp_path / "whole.las").read_bytes(), las(tmp_path / "whole.laz").read_bytes()
    count = slice(107, 111)
    huge = bytearray(survey)
    huge[count] = (4_000_000_000).to_bytes(4, "little")
    huge_zipped = bytearray(zipped)
    huge_zipped[count] = (4_000_000_000).to_bytes(4, "little")
    points_at = int.from_bytes(zipped[96:100], "little")
    table_at = int.from_bytes(zipped[points_at : points_at + 8], "little")
    chunks = zipped[: table_at + 4] + b"\xff" * 4 + zipped[table_at + 8 :]
    np.savez(tmp_path / "whole.npz", x=X, y=Y, t=T)
    archive = (tmp_path / "whole.npz").read_bytes()
    noise = np.random.default_rng(0).bytes(2000)
    return {
        "text.ply": text[:-9],
        "packed.ply": packed[:-9],
        "huge.ply": packed.replace(b"vertex 4", b"vertex 40000000000"),
        "huge_text.ply": text.replace(b"vertex 4", b"vertex 40000000000"),
        "words.ply": text.replace(b"-1", b"a"),
        "list.ply": packed.replace(b"property double time", b"property list uchar double time"),
        "faces.ply": text.replace(b"element vertex", b"element face"),
        "empty.ply": b"",
        "noise.ply": b"ply\n" + noise,
        "cut.pcd": padded[:-28],
        "cut_inside.pcd": padded[:-5],
        "cut_text.pcd": written[: written.rindex(b"5 -4")],
        "huge.pcd": padded.replace(b"POINTS 4", b"POINTS 4000000000").replace(b"WIDTH 4", b"WIDTH 4000000000"),
        "compressed.pcd": padded.replace(b"DATA binary", b"DATA binary_compressed"),
        "header.pcd": padded[:60],
        "noise.pcd": noise,
        "cut.las": survey[:-28],
        "cut_inside.las": survey[:-5],
        "huge.las": bytes(huge),
        "huge.laz": bytes(huge_zipped),
        "chunks.laz": chunks,
        "cut.laz": zipped[:-20],
        "noise.las": b"LASF" + noise,
        "cut.npz": archive[:200],
        "array.npz": b"\x93NUMPY" + noise,
        "map.xyz": b"1 2 3\n",
    }


@pytest.mark.parametrize("name", ["map.las", "map.laz"])
def test_a_survey_that_claims_more_records_than_it_has_room_for_is_refused(tmp_path: Path, name: str) -> None:
    content = bytearray(las(tmp_path / name).read_bytes())
    content[100:104] = (100_000).to_bytes(4, "little")  # a thousand times as many would fill the memory
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match="has a damaged header"):
        read_cloud(tmp_path / name)


@pytest.mark.filterwarnings("ignore")
def test_damaged_clouds_are_named_in_one_line(tmp_path: Path) -> None:
    for name, content in damaged(tmp_path).items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DataError, match=name) as raised:
            read_cloud(tmp_path / name)
        assert "\n" not in str(raised.value), name
    with pytest.raises(DataError, match=r"missing\.ply: is not a readable \.ply \(No such file"):
        read_cloud(tmp_path / "missing.ply")


@pytest.mark.parametrize(
    ("arrays", "problem"),
    [
        ({"x": X, "y": Y, "t": T[:3]}, "has different numbers of values: 4 of x, 4 of y and 3 of t"),
        ({"x": X, "y": Y, "t": np.array(["a"] * 4)}, "t is 1-dimensional <U1, not a number per point"),
        ({"x": X, "y": Y, "t": np.array([{}] * 4)}, "is not a readable"),
        ({"points": np.zeros((4, 5)), "t": T}, r"has points of shape \(4, 5\)"),
        ({"x": X[:0], "y": Y[:0], "t": T[:0]}, "holds no points"),
        ({"x": X, "y": Y, "t": T * 1e40}, "t holds stamps too large for any clock"),
    ],
)
def test_an_npz_that_is_no_cloud_is_refused(tmp_path: Path, arrays: dict[str, NDArray[Any]], problem: str) -> None:
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(DataError, match=rf"map\.npz: {problem}"):
        read_cloud(tmp_path / "map.npz")


def test_a_range_of_z_that_holds_nothing_or_has_no_z_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"map\.ply: holds no points"):
        read_cloud(ply(tmp_path / "map.ply", "double", T), z_range=(20.0, 30.0))
    np.savez(tmp_path / "flat.npz", x=X, y=Y, t=T)
    with pytest.raises(DataError, match=r"flat\.npz: has no z"):
        read_cloud(tmp_path / "flat.npz", z_range=(0.0, 1.0))


def some_map(count: int) -> PointMap:
    rng = np.random.default_rng(4)
    return PointMap(
        points=rng.uniform(-50.0, 50.0, (count, 2)),
        times=np.sort(rng.uniform(0.0, 900.0, count)),
        intensities=rng.uniform(60.0, 255.0, count),
        psi=rng.uniform(0.0, 0.1, count),
        matched=rng.random(count) < 0.8,
    )


def test_ply_is_binary_little_endian_with_the_promised_properties(tmp_path: Path) -> None:
    write_ply(tmp_path / "map.ply", some_map(7))
    header = (tmp_path / "map.ply").read_bytes().split(b"end_header")[0].decode("ascii").splitlines()
    assert header[1] == "format binary_little_endian 1.0"
    assert [line.split()[1:] for line in header if line.startswith("property")] == [
        ["float", "x"],
        ["float", "y"],
        ["float", "z"],
        ["float", "intensity"],
        ["double", "time"],
        ["float", "psi"],
    ]


def test_an_empty_map_is_a_valid_ply(tmp_path: Path) -> None:
    write_ply(tmp_path / "map.ply", some_map(0))
    assert PlyData.read(str(tmp_path / "map.ply"))["vertex"].count == 0


def test_open3d_reads_every_attribute_of_every_point(tmp_path: Path) -> None:
    try:
        import open3d
    except (ImportError, OSError) as error:
        pytest.skip(f"Open3D cannot be loaded here: {error}")
    written = some_map(500)
    write_ply(tmp_path / "map.ply", written)
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "map.ply"))
    positions = cloud.point.positions.numpy()
    np.testing.assert_allclose(positions[:, :2], written.points, rtol=1e-6)
    assert not positions[:, 2].any()
    np.testing.assert_array_equal(cloud.point["time"].numpy()[:, 0], written.times)
    np.testing.assert_allclose(cloud.point["intensity"].numpy()[:, 0], written.intensities, rtol=1e-6)
    np.testing.assert_allclose(cloud.point["psi"].numpy()[:, 0], written.psi, rtol=1e-6)


def test_a_folder_that_is_not_there_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"map\.ply"):
        write_ply(tmp_path / "absent" / "map.ply", some_map(3))


def test_importing_the_module_loads_no_heavy_package() -> None:
    code = "import sys, mqslam.formats.ply; print({'open3d', 'plyfile', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_map_says_that_a_lidar_made_it(tmp_path: Path) -> None:
    write_ply(tmp_path / "radar.ply", some_map(3), MapClock(0, 250_000))
    write_ply(tmp_path / "lidar.ply", some_map(3), MapClock(0, 250_000, is_of_lidar=True))
    write_ply(tmp_path / "unknown.ply", some_map(3))
    clouds = [read_cloud(tmp_path / name) for name in ("radar.ply", "lidar.ply", "unknown.ply")]
    assert [cloud.is_of_radar for cloud in clouds] == [True, False, False]
    assert [cloud.scan_us for cloud in clouds] == [250_000, 250_000, None]


def test_a_map_states_its_clock_in_a_comment(tmp_path: Path) -> None:
    clock = MapClock(start_us=1_547_131_046_353_776, scan_us=250_000)
    write_ply(tmp_path / "with.ply", some_map(3), clock)
    write_ply(tmp_path / "without.ply", some_map(3))
    assert read_clock(tmp_path / "with.ply") == MapClock(0, 250_000) and read_clock(tmp_path / "without.ply") is None
    stamped, plain = (PlyData.read(str(tmp_path / name))["vertex"]["time"] for name in ("with.ply", "without.ply"))
    np.testing.assert_allclose(stamped - plain, 1e-6 * clock.start_us, atol=1e-6)
    (tmp_path / "other.ply").write_text(
        "ply\ncomment mqslam clock: times are seconds since then us, a scan takes 1 us\nend_header\n"
    )
    assert read_clock(tmp_path / "other.ply") is None
