from __future__ import annotations

import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.recordings import START_US, TURN_US, assert_same, assert_same_polar_scan

from mqslam.errors import ConfigError, DataError
from mqslam.formats.conversion import write_recording
from mqslam.formats.recordings import list_targets, open_recording
from mqslam.formats.recordings.native import write as write_native


@pytest.fixture
def native(oxford: Path, tmp_path: Path) -> Path:
    path = tmp_path / "drive.npz"
    write_native(path, open_recording(oxford))
    return path


def test_a_written_recording_reads_back_identical(oxford: Path, native: Path) -> None:
    written, read = open_recording(oxford), open_recording(native)
    assert read.format == "native"
    assert (read.range_resolution, read.notes) == (written.range_resolution, written.notes)
    assert read.odometry is None and read.ground_truth is None
    assert_same(written, pickle.loads(pickle.dumps(read)))
    assert_same_polar_scan(written[4], read[4])


def test_odometry_and_ground_truth_are_kept(oxford: Path, tmp_path: Path) -> None:
    stamps = [START_US, START_US + TURN_US, START_US + 9 * TURN_US]
    (oxford / "odom.csv").write_text("t,v,omega\n{},1,0.2\n{},2,0\n{},0,0\n".format(*stamps))
    (oxford / "gt").mkdir()
    (oxford / "gt" / "poses_tum.txt").write_text("1700000000.0 0 0 0 0 0 0 1\n1700000001.0 3 0 0 0 0 0 1\n")
    written = open_recording(oxford)
    write_native(tmp_path / "drive.npz", written)
    read = open_recording(tmp_path / "drive.npz")
    for ours, theirs in ((read.odometry, written.odometry), (read.ground_truth, written.ground_truth)):
        assert ours is not None and theirs is not None
        np.testing.assert_array_equal(ours.stamps_us, theirs.stamps_us)
        np.testing.assert_array_equal(ours.poses, theirs.poses)


def test_range_resolution_can_be_overridden(native: Path) -> None:
    given = open_recording(native, range_resolution=0.1)
    assert given.range_resolution == 0.1 and any("are 0.1 m long, as given" in note for note in given.notes)


def test_the_range_offset_is_kept_or_named_as_lost(oxford: Path, tmp_path: Path) -> None:
    recording = open_recording(oxford, range_offset=-0.25)
    for number, target in enumerate(list_targets()):
        out = tmp_path / f"kept{number}{target.suffix}"
        notes = write_recording(recording, out, target, lambda done, total: None)
        (lost,) = [note for note in notes if "does not hold the range offset" in note] or [""]
        assert open_recording(out).range_offset == (pytest.approx(-0.25, abs=1e-5) if target.range_offset else 0.0)
        assert lost.endswith("sensor.range_offset_m: -0.25") == (not target.range_offset)


def test_a_range_offset_that_no_radar_has_is_refused(oxford: Path, native: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"range offset 31.0: cannot be the range offset of a radar; give metres"):
        open_recording(native, range_offset=31.0)
    (oxford / "recording.json").write_text('{"range_resolution_m": 0.0438, "range_offset_m": -31}')
    with pytest.raises(DataError, match=r"recording.json: states a range_offset_m that no radar has"):
        open_recording(oxford)
    write_native(tmp_path / "far.npz", replace(open_recording(native), range_offset=31.0))
    with pytest.raises(DataError, match=r"has a range offset of 31.0 m"):
        open_recording(tmp_path / "far.npz")


def test_a_recording_that_cannot_be_read_leaves_no_file(oxford: Path, tmp_path: Path) -> None:
    recording = open_recording(oxford)
    (oxford / "radar" / f"{recording.stamps_us[3]}.png").unlink()
    with pytest.raises(DataError):
        write_native(tmp_path / "drive.npz", recording)
    assert not list(tmp_path.glob("*drive.npz*"))


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.99])
def test_a_truncated_file_is_named(native: Path, keep: float) -> None:
    content = native.read_bytes()
    native.write_bytes(content[: int(len(content) * keep)])
    with pytest.raises(DataError, match=r"drive\.npz: is not a readable"):
        open_recording(native)


def test_flipped_bytes_in_a_polar_scan_are_named(native: Path) -> None:
    with zipfile.ZipFile(native) as archive:
        offset = archive.getinfo("power_000003.npy").header_offset + 1000
    content = bytearray(native.read_bytes())
    content[offset] ^= 0xFF
    native.write_bytes(content)
    recording = open_recording(native)
    assert len(list(recording.polar_scans(0, 3))) == 3
    with pytest.raises(DataError, match=r"drive\.npz: power_000003 is missing or damaged"):
        recording[3]


def test_another_programs_npz_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(DataError, match=r"other\.npz: stamps_us is missing"):
        open_recording(tmp_path / "other.npz")


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", stamps_us=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match=r"other\.npz: stamps_us is missing or damaged"):
        open_recording(tmp_path / "other.npz")
