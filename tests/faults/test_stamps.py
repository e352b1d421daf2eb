"""Stamps that repeat, jitter, jump or stop for a while, and a turn rate that changes."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from support.commands import mqslam
from support.conversions import write_jittered
from support.faults import assert_refused, images, read_summary, run_quickly, small_street
from support.layouts import left_turn, write_radiate
from support.recordings import TURN_US, bag_writer, raw_rows, with_metadata, write_png

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.detection.stage import detect_all
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings import oxford as writer
from mqslam.formats.tum import read_tum


def test_polar_scans_that_are_missing(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[12:16]:
        image.unlink()
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0 and "warning: radar gap of 1.00 s after scan 11 (counted from 0)" in shown.err
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 26
    assert read_summary(tmp_path / "out")["evaluation"]["ate_rmse_m"] < 0.5


def test_stamps_that_repeat_or_run_backward(drive: Path, tmp_path: Path) -> None:
    expected = open_recording(drive)
    listing = drive / "radar.timestamps"
    lines = listing.read_text().splitlines()
    listing.write_text("\n".join([*lines[5:], *lines[:5], lines[7]]) + "\n")
    assert open_recording(drive).stamps_us.tolist() == expected.stamps_us.tolist()
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0 and "radar.timestamps runs backward 1 time" in shown.err
    assert "radar.timestamps lists 1 stamp more than once" in shown.err
    assert_refused(run_quickly(drive, tmp_path / "strict", "--strict"), "runs backward")
    bag = write_stray(tmp_path, expected)
    assert open_recording(bag).stamps_us.tolist() == np.delete(expected.stamps_us, 4).tolist()
    assert "the stamps of 1 message on /Navtech/Polar repeat or run backward" in open_recording(bag).faults[0]


def write_stray(folder: Path, recording: Recording) -> Path:
    """Writes a bag whose fifth message is stamped an hour too late."""
    with bag_writer(folder / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        for k, (stamp, rows) in enumerate(raw_rows(recording)):
            late = 3_600_000_000 if k == 4 else 0
            stamps = rows[:, :8].copy().view("<i8")[:, 0] + late
            ticks = rows[:, 8:10].copy().view("<u2")[:, 0].astype(np.int64)
            image = with_metadata(rows[:, 11:], stamps, ticks, rows[:, 10] == 255)
            bag.write(radar, stamp, bag.image(stamp + late, image))
    return folder / "drive.bag"


def test_stamps_of_arrival_that_jitter(tmp_path: Path) -> None:
    delays = np.random.default_rng(1).uniform(0.0, 20_000.0, 60)
    drive = write_jittered(tmp_path, "radiate", delays)
    shown = mqslam("info", drive)
    assert shown.code == 0 and "the arrival stamps jitter more than a turning radar can: they are smoothed" in shown.out
    assert np.abs(np.diff(open_recording(drive).stamps_us[1:]) - TURN_US).max() < 1000


def test_stamps_of_arrival_that_are_damaged(tmp_path: Path) -> None:
    listing = write_radiate(tmp_path / "city", left_turn()) / "Navtech_Polar.txt"
    listing.write_text(re.sub(r"(Frame: 000004 Time: )\d+", r"\g<1>1234567890", listing.read_text()))
    city = open_recording(tmp_path / "city")
    assert len(city) == 6 and "the stamp of polar scan number 4 among 6 lies too far" in city.faults[0]


def test_a_clock_that_jumps(drive: Path, tmp_path: Path) -> None:
    whole = open_recording(drive)
    assert whole.ground_truth is not None
    truth = whole.ground_truth.at(whole.stamps_us)
    for image in images(drive)[15:]:
        with Image.open(image) as whole:
            rows = np.asarray(whole)
        stamps = rows[:, :8].copy().view("<i8")[:, 0] + 7_200_000_000
        image.unlink()
        write_png(drive, np.hstack([stamps[:, None].view(np.uint8).reshape(len(rows), 8), rows[:, 8:]]))
    (drive / "radar.timestamps").unlink()
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0
    assert "warning: jump of the clock or pause of 7200.00 s after scan 14 (counted from 0)" in shown.err
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    assert len(track) == 30 and np.abs(track.poses[:, :2]).max() < 200.0  # two hours at this speed would be 50 km
    for half in (slice(0, 15), slice(19, 30)):
        moves, expected = (se2.between(poses[half][:-1], poses[half][1:]) for poses in (track.poses, truth))
        np.testing.assert_allclose(moves[:, 0], expected[:, 0], rtol=0.0, atol=0.3)


def test_a_turn_rate_that_changes(tmp_path: Path) -> None:
    slow, fast = small_street(2.0, 12.0), small_street(4.0, 12.0)
    drive = tmp_path / "drive"
    (drive / "radar").mkdir(parents=True)
    halfway = slow.start_us + 6_000_000
    for recording, chosen in ((slow, slow.stamps_us < halfway), (fast, fast.stamps_us >= halfway)):
        for k in np.flatnonzero(chosen).tolist():
            writer.write_polar_scan(drive, recording, k, recording[k])
    (drive / "simulation.json").write_text('{"range_resolution_m": 0.175}')
    shutil.copytree(write_truth(tmp_path, fast), drive / "gt")
    recording = open_recording(drive)
    assert len(recording) == 12 + 24 and recording.gaps() == []
    scans, _ = detect_all(recording, Config().detector)
    assert [round(w.t1 - w.t0, 3) for w in scans] == [0.5] * 12 + [0.25] * 24
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0 and "gap" not in shown.err
    assert "lost track" not in shown.err and read_summary(tmp_path / "out")["evaluation"]["ate_rmse_m"] < 0.5


def write_truth(folder: Path, recording: Recording) -> Path:
    (folder / "truth").mkdir()
    writer.write_ground_truth(folder / "truth", recording)
    return folder / "truth" / "gt"
