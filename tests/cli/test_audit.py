"""`mqslam audit` from the command line: what it writes, what it says and how it exits."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.core.trajectory import Trajectory
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import read_tum, write_tum

TABLES = {
    "audit.md",
    "junit.xml",
    "audit.csv",
    "steps.csv",
    "spans.csv",
    "revisits.csv",
    "bad_places.csv",
    "bad_places.geojson",
}
FILES = {"audit.json", "heatmap.png", "report.html", "config.yaml", "run.log", *TABLES}


@pytest.fixture(scope="module")
def tracks(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The truth of the street as other programs would write it, and a bent copy."""
    folder = tmp_path_factory.mktemp("tracks")
    truth = read_tum(street / "gt" / "poses_tum.txt")
    write_tum(folder / "true.tum", truth)
    write_kitti(folder / "true.kitti", truth)
    (folder / "times.txt").write_text("".join(f"{t / 1e6:.6f}\n" for t in truth.stamps_us.tolist()))
    bent = truth.poses * [1.05, 1.05, 1.0]
    write_tum(folder / "bent.tum", Trajectory(truth.stamps_us, bent))
    return folder


def audited(street: Path, out: Path, *more: str | Path) -> dict:
    result = mqslam("audit", street, "--out", out, "--quiet", *more)
    assert (result.code, result.err) == (0, "")
    return json.loads((out / "audit.json").read_text())


def test_a_true_trajectory_passes_in_every_form(street: Path, tracks: Path, quick: Path, tmp_path: Path) -> None:
    tum = audited(street, tmp_path / "tum", "--trajectory", tracks / "true.tum")
    assert {p.name for p in (tmp_path / "tum").iterdir()} == FILES
    assert tum["verdict"]["status"] == "pass" and tum["windows"]["torn"] == 0
    times = ("--times", tracks / "times.txt")
    kitti = audited(street, tmp_path / "k", "--trajectory", tracks / "true.kitti", *times, "--config", quick)
    own = audited(street, tmp_path / "o", "--trajectory", "ground_truth", "--config", quick)
    for other in (kitti, own):
        assert other["windows"]["inflation_median"] == pytest.approx(tum["windows"]["inflation_median"], rel=1e-3)
    rows = list(csv.DictReader((tmp_path / "tum" / "audit.csv").read_text().splitlines()))
    assert len(rows) == tum["windows"]["count"] == len(tum["per_window"])
    assert float(rows[2]["inflation"]) == pytest.approx(tum["per_window"][2]["inflation"], rel=1e-6)


def test_a_bent_trajectory_fails_and_says_what_would_mend_it(
    street: Path, tracks: Path, quick: Path, tmp_path: Path
) -> None:
    words = ("audit", street, "--trajectory", tracks / "bent.tum", "--config", quick)
    result = mqslam(*words, "--out", tmp_path / "a", "--fail-on", "fail")
    assert result.code == 1 and result.out.startswith("verdict       fail: ") and "torn window" in result.out
    summary = json.loads((tmp_path / "a" / "audit.json").read_text())
    speeds = [row["dv"] for row in summary["per_window"]]
    assert np.median(speeds) == pytest.approx(-0.05 * 8.0, abs=0.12)  # the street is driven at about 8 m/s
    assert mqslam(*words, "--out", tmp_path / "b", "--quiet").code == 0
    by_speed = {"torn": True, "by_speed": True, "speed_error": 9.0}
    assert all(not row["by_speed"] for row in summary["per_window"])  # the page calls these windows bent, too
    summary["per_window"] = [row | by_speed for row in summary["per_window"]]
    summary |= {"notes": ["of another drive"], "warnings": ["no odometry"]}
    (tmp_path / "b" / "audit.json").write_text(json.dumps(summary))
    shown = mqslam("show", tmp_path / "b")
    assert "m: not bent, but the scans contradict its speed by 9 m/s\n" in shown.out
    assert shown.err == "note: of another drive\nwarning: no odometry\n"


def test_each_test_gives_a_p_value_and_the_rate_of_false_alarms_decides(
    street: Path, tracks: Path, quick: Path, tmp_path: Path
) -> None:
    truth = read_tum(tracks / "true.tum")
    poses = truth.poses.copy()
    poses[len(poses) // 2 :, 0] += 0.25  # a lasting jump
    write_tum(tmp_path / "jump.tum", Trajectory(truth.stamps_us, poses))
    words = ("--trajectory", tmp_path / "jump.tum", "--config", quick)
    summary = audited(street, tmp_path / "a", *words)
    p_value = summary["tests"]["steps"]["p_value"]
    assert summary["tests"]["steps"]["status"] == "warn" and 0.0 < p_value < 0.002
    assert p_value == min(row["p_value"] for row in summary["per_step"] if row["p_value"] is not None)
    windows = [row["p_value"] for row in summary["per_window"] if row["torn"] is not None]
    assert summary["tests"]["windows"]["p_value"] == min(windows) and summary["tests"]["revisits"]["p_value"] is None
    assert "p_value" in (tmp_path / "a" / "audit.csv").read_text().splitlines()[0].split(",")
    strict = audited(street, tmp_path / "b", *words, "--false-alarms", "1e-250")
    assert strict["tests"]["steps"]["status"] == "pass"
    assert strict["tests"]["steps"]["p_value"] > strict["false_alarms"]["p_value_below"]
    assert p_value < summary["false_alarms"]["p_value_below"]
    assert "false_alarms: 1.0e-250" in (tmp_path / "b" / "config.yaml").read_text()


def test_what_could_not_be_judged_has_a_line_of_its_own(street: Path, tracks: Path, quick: Path, tmp_path: Path) -> None:
    truth = read_tum(tracks / "true.tum")
    half = len(truth) // 2
    write_tum(tmp_path / "half.tum", Trajectory(truth.stamps_us[:half], truth.poses[:half]))
    words = ("--trajectory", tmp_path / "half.tum", "--config", quick)
    lines = mqslam("audit", street, "--out", tmp_path / "a", *words).out.splitlines()
    summary = json.loads((tmp_path / "a" / "audit.json").read_text())
    first = next(k for k, line in enumerate(lines) if line.startswith("not judged    "))
    unseen = "drift: no place is passed twice, so that drift of any size could hide"
    assert lines[0].startswith("verdict       ") and unseen in summary["not_judged"]
    assert "24 of 48 scans: the trajectory has poses from 0.0 s to 5.8 s only" in summary["not_judged"]
    assert [line[14:] for line in lines[first : first + len(summary["not_judged"])]] == summary["not_judged"]
    judged = json.loads(mqslam("audit", street, "--out", tmp_path / "b", "-t", tracks / "true.tum", "--json").out)
    assert not any("scans:" in text for text in judged["not_judged"]) and unseen in judged["not_judged"]


def test_the_numbers_are_printed_as_json(street: Path, tracks: Path, quick: Path, tmp_path: Path) -> None:
    result = mqslam("audit", street, "-t", tracks / "true.tum", "--config", quick, "--out", tmp_path / "a", "--json")
    assert json.loads(result.out) == json.loads((tmp_path / "a" / "audit.json").read_text())


def test_the_map_and_the_trajectory_of_a_run_fit_together(finished: Path, tmp_path: Path) -> None:
    summary = audited(finished / "map.ply", tmp_path / "a", "--trajectory", finished / "trajectory.tum")
    track = read_tum(finished / "trajectory.tum")
    assert track.stamps_us[0] > 10**15
    assert summary["dataset"]["format"] == "ply" and summary["windows"]["count"] > 3
    assert summary["dataset"]["sweeps"] == pytest.approx(len(track), abs=2)  # as many as the radar's own scans
    assert summary["dataset"]["length_m"] == pytest.approx(track.length_m, rel=0.05)
    assert summary["revisits"] is not None


def test_the_map_of_a_run_alone_is_judged_locally_only(finished: Path, tmp_path: Path) -> None:
    result = mqslam("audit", finished / "map.ply", "--out", tmp_path / "a", "--fail-on", "fail")
    summary = json.loads((tmp_path / "a" / "audit.json").read_text())
    assert summary["trajectory"] is None and summary["revisits"] is None and summary["dataset"]["length_m"] is None
    unjudged = "drift and revisits cannot be judged without the cloud's trajectory"
    assert unjudged in result.out
    assert summary["verdict"]["status"] != "pass"
    assert any(unjudged in r for r in summary["verdict"]["reasons"])


def test_a_trajectory_of_another_clock_takes_an_offset(finished: Path, tmp_path: Path) -> None:
    track = read_tum(finished / "trajectory.tum")
    write_tum(tmp_path / "late.tum", Trajectory(track.stamps_us + 3_600_250_000, track.poses))
    words = ("audit", finished / "map.ply", "--trajectory", tmp_path / "late.tum", "--quiet")
    result = mqslam(*words, "--out", tmp_path / "a")
    assert result.code == 2 and "map.ply" in result.err and "or --time-offset if their clocks differ" in result.err
    right = audited(finished / "map.ply", tmp_path / "b", "--trajectory", finished / "trajectory.tum")
    shifted = audited(finished / "map.ply", tmp_path / "c", "-t", tmp_path / "late.tum", "--time-offset", "-3600.25")
    assert shifted["per_window"] == right["per_window"]
    result = mqslam(*words, "--out", tmp_path / "d", "--time-offset", "1e15")
    assert result.code == 2 and "no possible offset of a clock" in result.err


def test_a_baseline_fails_what_got_worse(street: Path, tracks: Path, quick: Path, tmp_path: Path) -> None:
    words = ("--trajectory", tracks / "bent.tum", "--config", quick)
    before = audited(street, tmp_path / "before", *words)
    assert before["baseline"] is None and before["verdict"]["status"] == "fail"
    shown = mqslam("audit", street, "--out", tmp_path / "same", *words, "--baseline", tmp_path / "before")
    assert shown.code == 0 and f"nothing is worse than in {tmp_path / 'before'}" in shown.out
    same = json.loads((tmp_path / "same" / "audit.json").read_text())
    assert same["baseline"] == {"path": str(tmp_path / "before"), "worse": []}
    bad = next(name for name, test in before["tests"].items() if test["status"] == "fail")
    before["tests"][bad]["status"] = "pass"
    (tmp_path / "before" / "audit.json").write_text(json.dumps(before))
    shown = mqslam("audit", street, "--out", tmp_path / "after", *words, "--baseline", tmp_path / "before")
    assert shown.code == 1 and f"worse than {tmp_path / 'before'}: {bad} is fail and was pass" in shown.out
    assert f"- {bad} is fail and was pass" in (tmp_path / "after" / "audit.md").read_text()
    shown = mqslam("audit", street, "--out", tmp_path / "none", *words, "--baseline", tracks)
    assert shown.code == 2 and "holds no result" in shown.err and not (tmp_path / "none").exists()
