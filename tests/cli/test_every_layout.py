"""A drive in every layout goes through every command, and comes out with the motion that it went in with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.conversions import EVEN, STAMPED, convert
from support.parameters import mostly_slow

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.simulator import SensorModel, simulate

LAYOUTS = (*STAMPED, *EVEN)
DISTINCT = [name for name in LAYOUTS if name != "rosbag2_mcap"]  # that one is an mcap in a folder


def twists(track: Trajectory) -> se2.Array:
    """Returns the mean twists between a trajectory's poses [m/s, m/s, rad/s]."""
    return track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])


@pytest.fixture(scope="module")
def sample(oxford_tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real polar scans, run from the layout they have."""
    out = tmp_path_factory.mktemp("sample") / "run"
    assert mqslam("run", oxford_tiny, "--out", out, "--range-resolution", 0.0438, "--quiet").code == 0
    return out


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ("radiate",)))
def test_the_real_sample_moves_alike_in_every_layout_and_back(
    oxford_tiny: Path, sample: Path, tmp_path: Path, layout: str
) -> None:
    there, _ = convert(open_recording(oxford_tiny, range_resolution=0.0438), tmp_path, layout)
    back, _ = convert(open_recording(there, range_resolution=0.0438), tmp_path / "back", "oxford")
    recordings = (there, back) if layout in (*EVEN, "boreas") else (back,)
    options = ("--range-resolution", 0.0438, "--config", sample / "config.yaml", "--quiet")  # with the same Doppler shift
    for number, recording in enumerate(recordings):
        out = tmp_path / f"run{number}"
        assert mqslam("run", recording, "--out", out, *options).code == 0
        estimate, expected = (read_tum(run / "trajectory.tum") for run in (out, sample))
        if layout in EVEN or recording == there:  # there the stamps of turns may be those of their middles or ends
            off = np.abs(twists(estimate) - twists(expected))
            # stamps of whole turns are smoothed as far as a turning mass allows, and this radar's turns wander by 5 ms
            assert off[:, :2].max() <= 0.1 and off[:, 2].max() <= 0.005
        else:
            np.testing.assert_allclose(estimate.poses, expected.poses, rtol=0.0, atol=1e-6)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four simulated seconds of a street, with wheel odometry and ground truth."""
    out = tmp_path_factory.mktemp("short") / "drive"
    simulate(
        out,
        scene="street",
        duration_s=4.0,
        sensor=SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0),
        movers=2,
        seed=2,
    )
    return out


@pytest.mark.parametrize("layout", mostly_slow(DISTINCT, ("boreas", "rosbag1", "mulran")))
def test_a_drive_goes_through_every_command(short: Path, tmp_path: Path, layout: str) -> None:
    drive, _ = convert(open_recording(short), tmp_path, layout)
    quick = tmp_path / "quick.yaml"
    quick.write_text("sensor: {doppler_beta: 0.0}\n")  # measuring it takes longer than all that is tested here
    bins = ("--range-resolution", 0.175)
    known = (*bins, "--config", quick)
    shown = mqslam("info", drive, *bins, "--json")
    assert shown.code == 0 and json.loads(shown.out)["revolutions"] == 16
    assert mqslam("run", drive, *known, "--out", tmp_path / "run", "--quiet").code == 0
    truth = open_recording(short).ground_truth
    assert truth is not None
    estimate = read_tum(tmp_path / "run" / "trajectory.tum")
    inside = (estimate.stamps_us[:-1] >= truth.stamps_us[0]) & (estimate.stamps_us[1:] <= truth.stamps_us[-1])
    off = np.abs(twists(estimate) - truth.mean_twists(estimate.stamps_us[:-1], estimate.stamps_us[1:]))[inside]
    assert np.median(off[:, 0]) < 0.1 and np.median(off[:, 2]) < 0.02
    mine = f"mine={tmp_path / 'run' / 'trajectory.tum'}"
    asked = (*known, "--frontends", "odometry", "--odometry-only", "--trajectory", mine, "--json")
    shown = mqslam("compare", drive, *asked, "--out", tmp_path / "compared")
    assert shown.code == 0 and {row["name"] for row in json.loads(shown.out)["rows"]} == {"odometry", "mine"}
    track = ("--trajectory", tmp_path / "run" / "trajectory.tum")
    shown = mqslam("audit", drive, *track, *known, "--out", tmp_path / "audited", "--json")
    audited = json.loads(shown.out)
    assert shown.code == 0 and audited["windows"]["count"] >= 2 and audited["windows"]["torn"] == 0
    assert audited["verdict"]["status"] == "not judged"  # for want of windows
    assert mqslam("convert", drive, tmp_path / "again.mcap", *bins, "--quiet").code == 0
    assert len(open_recording(tmp_path / "again.mcap")) == 16


def test_a_trajectory_of_another_time_is_refused_before_the_recording_is_read(oxford: Path, tmp_path: Path) -> None:
    _, *between, _ = sorted((oxford / "radar").glob("*.png"))
    for image in between:
        image.write_bytes(b"")
    (tmp_path / "other.tum").write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    shown = mqslam("audit", oxford, "--trajectory", tmp_path / "other.tum", "--out", tmp_path / "out")
    assert shown.code == 2 and "share no time" in shown.err and "could not be read" not in shown.err
    shown = mqslam("compare", oxford, "--trajectory", f"other={tmp_path / 'other.tum'}", "--out", tmp_path / "out")
    assert shown.code == 2 and "other covers 0" in shown.err and "detect" not in shown.err
