"""What `mqslam diff` leaves out of a comparison, and the reasons that it gives."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam, parse_strict_json

import mqslam as package
from mqslam.config import Config, dump_yaml
from mqslam.core.sensors import USUAL_INPUTS
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import fit_settings
from mqslam.formats.tum import read_tum, write_tum


def change_summary(folder: Path, **entries: object) -> None:
    """Replaces entries of a result's summary.json."""
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | entries))


def test_psi_of_a_lidars_runs_compares_where_only_settings_of_radars_differ(finished: Path, other: Path) -> None:
    dataset = package.read_result(finished).summary["dataset"]
    first = shutil.copytree(finished, other.with_name("first"))
    for folder in (first, other):
        change_summary(folder, dataset=dataset | {"format": "laserscan"})
    found = parse_strict_json(mqslam("diff", first, other, "--json").out)
    assert found["settings"] == {"detector.threshold": [40.0, 60.0]} and found["psi_not_compared"] is None
    settings = (other / "config.yaml").read_text()
    (other / "config.yaml").write_text(settings.replace("range_offset_m: null", "range_offset_m: 0.1"))
    assert parse_strict_json(mqslam("diff", first, other, "--json").out)["psi_not_compared"] is None
    (other / "config.yaml").write_text(settings.replace("lidar_fov_deg: null", "lidar_fov_deg: 270.0"))
    assert "reading.lidar_fov_deg" in parse_strict_json(mqslam("diff", first, other, "--json").out)["psi_not_compared"]


def test_diff_counts_settings_that_follow_from_the_recordings_apart(finished: Path, other: Path) -> None:
    first = shutil.copytree(finished, other.with_name("first"))
    usual = package.load_config("lidar")
    for folder, unit_m in ((first, 0.28), (other, 0.3)):
        (folder / "config.yaml").write_text(dump_yaml(fit_settings(Config(), usual, unit_m)))
    found = parse_strict_json(mqslam("diff", first, other, "--json").out)
    assert found["settings"] == {} and found["followed"]["psi.tau"] == [pytest.approx(0.14), pytest.approx(0.15)]
    assert found["psi_not_compared"].startswith("settings that follow from the recordings differ (estimator.s, ")
    line = f"settings that follow from the recordings: {len(found['followed'])} differences, which --json lists"
    assert f"settings: the same\n{line}\n" in mqslam("diff", first, other).out
    (other / "config.yaml").write_text((other / "config.yaml").read_text() + "former:\n  setting: 3\n")
    assert parse_strict_json(mqslam("diff", first, other, "--json").out)["followed"] == {}


def test_diff_compares_the_options_of_a_run_of_a_batch_with_those_of_a_run(
    finished: Path, other: Path, street: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = (finished / "run.log").read_text()
    (other / "run.log").write_text(log.replace("command: mqslam run", "command: mqslam batch"))
    row = {
        "name": other.name,
        "data": str(street),
        **asdict(USUAL_INPUTS),
        "frontend": "odometry",
        "start": None,
        "end": 4.0,
    }

    def diff_options(**changed: object) -> object:
        (other.parent / "batch.json").write_text(json.dumps({"warnings": [], "runs": [row | changed]}))
        return parse_strict_json(mqslam("diff", other, first, "--json").out)["options"]

    first = shutil.copytree(finished, other.with_name("first"))
    assert diff_options(end=None) == {} and diff_options(end=None, frame="lidar") == {}
    assert diff_options(imu="/imu.csv", frame="vehicle") == {
        **{"imu": ["/imu.csv", "auto"], "frame": ["vehicle", "radar"]},
        "end": [4.0, None],
    }
    monkeypatch.chdir(street.parent)
    (first / "run.log").write_text(log.replace(str(street), street.name).replace("--frontend odometry", "--end 4"))
    assert diff_options() == {"frontend": ["odometry", "psi"]}


def test_a_doppler_shift_that_both_runs_have_measured_is_no_setting(finished: Path, other: Path) -> None:
    first = shutil.copytree(finished, other.with_name("first"))
    settings = (finished / "config.yaml").read_text()
    (other / "config.yaml").write_text(settings.replace("doppler_beta: 0.0", "doppler_beta: 0.049"))
    doppler = {"sensor.doppler_beta": [0.0, 0.049]}
    change_summary(other, doppler_sigma=1e-4)
    assert parse_strict_json(mqslam("diff", first, other, "--json").out)["settings"] == doppler
    change_summary(first, doppler_sigma=1e-4)
    found = parse_strict_json(mqslam("diff", first, other, "--json").out)
    assert found["settings"] == {} and found["followed"] == doppler


def test_diff_gives_the_one_reason_why_trajectories_are_not_compared(finished: Path, other: Path) -> None:
    track = read_tum(finished / "trajectory.tum")
    (other / "trajectory.tum").unlink()
    reason = f"trajectories: not compared, because {other} holds no trajectory.tum\n"
    assert mqslam("diff", finished, other).out.endswith(reason) and mqslam("diff", other, finished).out.endswith(reason)
    write_tum(other / "trajectory.tum", Trajectory(track.stamps_us + 10**9, track.poses))
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert found["trajectories"] is None
    assert found["trajectories_not_compared"] == "the trajectories share fewer than 3 stamps"


@pytest.mark.parametrize(("size", "noise_m", "is_compared"), [(1.0, 0.1, True), (0.02, 0.1, False), (0.0, 0.1, False)])
def test_headings_are_compared_where_the_path_is_long_enough_to_align_them(
    size: float, noise_m: float, is_compared: bool, finished: Path, other: Path
) -> None:
    first = shutil.copytree(finished, other.with_name("first"))
    track, noise = read_tum(finished / "trajectory.tum"), np.random.default_rng(1).normal(0.0, noise_m, (2, 1000, 2))
    for folder, errors in zip((first, other), noise, strict=True):
        poses = track.poses * [size, size, 1.0]
        poses[:, :2] += errors[: len(poses)]
        poses[:, 2] += 0.02 * (folder == other)
        (folder / "trajectory.tum").unlink()
        write_tum(folder / "trajectory.tum", Trajectory(track.stamps_us, poses))
    apart = parse_strict_json(mqslam("diff", first, other, "--json").out)["trajectories"]
    assert apart["as_they_are"]["largest_rad"] == pytest.approx(0.02)
    shown = mqslam("diff", first, other).out.splitlines()[-1]
    if is_compared:
        assert apart["aligned"]["largest_rad"] < 0.03 and "; turned by " in shown
    else:
        assert apart["aligned"]["largest_rad"] is None and apart["aligned"]["turned_at_s"] is None
        assert f"headings not compared, because the positions, {apart['spread_m']:.3f} m RMS from their middle, " in shown
