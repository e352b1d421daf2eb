from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from mqslam.core.point_map import PointMap
from mqslam.errors import OutputError
from mqslam.formats.ply import MapClock, read_clock, write_ply


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
