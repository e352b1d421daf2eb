"""Images that cannot be read, and azimuths and files beside them that are missing or unusable."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.commands import mqslam, read_contents
from support.faults import assert_refused, cut_short, images, interrupt, read_summary, run_quickly, small_street, write_drive
from support.recordings import write_oxford

from mqslam.config import Config
from mqslam.detection.stage import detect_all
from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum


def test_an_image_that_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    broken = images(drive)[11:14]
    for image in broken:
        cut_short(image)
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0
    warning = f"warning: 3 polar scans could not be read and are left out: {broken[0]}: is not a readable PNG"
    assert warning in shown.err and str(broken[2]) in shown.err
    result = read_summary(tmp_path / "out")
    assert result["dataset"]["unread"] == 3 and "3 of 30 polar scans could not be read" in str(result["verdict"])
    assert "3 polar scans could not be read" in (tmp_path / "out" / "report.html").read_text()
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    assert track.stamps_us.tolist() == [int(image.stem) for image in images(drive)]
    assert result["evaluation"]["ate_rmse_m"] < 0.5
    before = read_contents(tmp_path)
    assert_refused(run_quickly(drive, tmp_path / "strict", "--strict", "--quiet"), f"{broken[0]}: is not a readable PNG")
    assert read_contents(tmp_path) == before


def test_an_unread_polar_scan_stays_one_when_a_run_is_resumed(drive: Path, tmp_path: Path) -> None:
    """This has no row in the README's table. A continued run knows what the interrupted one could not read."""
    cut_short(images(drive)[11])
    assert run_quickly(drive, tmp_path / "whole").code == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mqslam.slam.Problem", interrupt)
        assert run_quickly(drive, tmp_path / "out").code == 130
    shown = run_quickly(drive, tmp_path / "out", "--resume")
    assert shown.code == 0 and "1 polar scan could not be read and is left out" in shown.err
    for name in ("trajectory.tum", "measurements.csv", "covariances.csv", "map.ply"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_first_or_last_image_that_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    first, second, *_, last = images(drive)
    for image in (first, second, last):
        cut_short(image)
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0
    assert f"the first 2 polar scans could not be read and are left out: {first}: " in shown.err
    assert f"the last polar scan could not be read and is left out: {last}: " in shown.err
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 27
    assert_refused(run_quickly(drive, tmp_path / "strict", "--strict"), str(first))


def test_over_half_of_the_images_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[3:22]:
        cut_short(image)
    before = read_contents(tmp_path)
    shown = run_quickly(drive, tmp_path / "out", "--quiet")
    assert_refused(shown, "is not a readable PNG", "; 19 of 30 polar scans cannot be used; ")
    assert read_contents(tmp_path).keys() - before.keys() == {"quick.yaml"}


def test_a_stretch_that_cannot_be_read_costs_no_more_than_itself(drive: Path) -> None:
    """This has no row in the README's table. Reading goes on after an error, in a recording of any layout."""
    broken = [3, 4, 11, 29 - 1]
    for k in broken:
        cut_short(images(drive)[k])
    recording = open_recording(drive)
    good = detect_all(open_recording(lane_like(drive)), Config().detector)[0]
    scans, result = detect_all(recording, Config().detector)
    assert sorted(result.unread) == broken and all(isinstance(error, DataError) for error in result.unread.values())
    for k, (one, other) in enumerate(zip(scans, good, strict=True)):
        assert (one.t0, one.t1) == (other.t0, other.t1)
        assert len(one.returns) == (0 if k in broken else len(other.returns))


def lane_like(drive: Path) -> Path:
    """Returns the undamaged drive that a copy was made of."""
    folder = drive.parent / "whole"
    write_drive(folder, small_street())
    return folder


@pytest.mark.parametrize("name", ["odom.csv", "gt/poses_tum.txt"])
@pytest.mark.parametrize("text", ["t,v,omega\n1,2\n", "", "1 0 0 0 0 0 0 1\n", "\x00"])
def test_odometry_poses_or_ground_truth_beside_the_images_that_cannot_be_used(tmp_path: Path, name: str, text: str) -> None:
    drive = write_oxford(tmp_path / "drive")
    (drive / "gt").mkdir()
    (drive / name).write_text(text)
    shown = mqslam("info", drive)
    assert shown.code == 0 and f"{drive / name} " in shown.out and ": left out" in shown.out
    recording = open_recording(drive)
    assert recording.odometry is None and recording.ground_truth is None and len(recording) == 6
    assert_refused(mqslam("run", drive, "--out", tmp_path / "out", "--strict"), str(drive / name), ": left out")


def test_azimuths_that_are_missing(drive: Path, tmp_path: Path) -> None:
    for k, rows in ((9, 120), (15, 12)):  # of 200
        image = images(drive)[k]
        with Image.open(image) as whole:
            pixels = np.asarray(whole)[:rows]
        Image.fromarray(pixels).save(image)
    recording = open_recording(drive)
    assert recording[9].power.shape[0] == 120 and len(recording) == 30
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0 and "1 polar scan could not be read" in shown.err
    assert f"{images(drive)[15]}: has 12 azimuths, the first image has 200" in shown.err
