"""`mqslam audit --mend`: what it writes beside the audit, what it says, and what it leaves alone."""

from __future__ import annotations

import html
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import mqslam, read_contents

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.formats.tum import read_tum, write_tum
from mqslam.results.audit_results import describe_mended

ACES = Path(__file__).parents[3] / "shared" / "data" / "carmen" / "aces-corrected.log.gz"


@pytest.fixture(scope="module")
def bent(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The truth of the street, 1.5 % too long."""
    truth = read_tum(street / "gt" / "poses_tum.txt")
    path = tmp_path_factory.mktemp("tracks") / "bent.tum"
    write_tum(path, Trajectory(truth.stamps_us, truth.poses * [1.015, 1.015, 1.0]))
    return path


def test_the_audit_stays_and_the_mended_trajectory_stands_beside_it(
    street: Path, bent: Path, quick: Path, tmp_path: Path
) -> None:
    words = ("audit", street, "--trajectory", bent, "--config", quick, "--fail-on", "warn")
    plain = mqslam(*words, "--out", tmp_path / "plain")
    mending = mqslam(*words, "--out", tmp_path / "mended", "--mend")
    assert plain.code == mending.code == 1  # judged as it was given
    assert mending.out.splitlines()[0] == plain.out.splitlines()[0]
    assert "\nmended        " in mending.out and "\nverdict then  " in mending.out and "mended" not in plain.out
    before = json.loads((tmp_path / "plain" / "audit.json").read_text())
    after = json.loads((tmp_path / "mended" / "audit.json").read_text())
    judged = after | {"covariances": {"statement": "the covariances of the trajectory are too small"}}
    (tmp_path / "plain" / "audit.json").write_text(json.dumps(judged))
    listed = mqslam("show", tmp_path / "plain").out
    assert f"\ncovariances   {judged['covariances']['statement']}\nmended        {after['mended']['sentence']}\n" in listed
    mended = after.pop("mended")
    assert after == before
    assert set(read_contents(tmp_path / "mended")) - set(read_contents(tmp_path / "plain")) == {"mended.tum"}
    truth, track = read_tum(street / "gt" / "poses_tum.txt"), read_tum(tmp_path / "mended" / "mended.tum")
    assert track.stamps_us.tolist() == read_tum(bent).stamps_us.tolist()
    assert track.length_m == pytest.approx(truth.length_m, rel=0.005)
    assert mended["windows"]["torn"] < before["windows"]["torn"] and not mended["worse"]
    page = (tmp_path / "mended" / "report.html").read_text(encoding="utf-8")
    assert mended["sentence"] in page and "As it was given" in page
    assert f"The mended trajectory is judged {mended['verdict']['status']}: " in page
    assert all(reason in html.unescape(page) for reason in mended["verdict"]["reasons"])
    given = ("--trajectory", tmp_path / "mended" / "mended.tum", "--config", quick)
    assert mqslam("audit", street, *given, "--out", tmp_path / "again", "-q").code == 0
    alone = json.loads((tmp_path / "again" / "audit.json").read_text())
    assert alone["verdict"] == mended["verdict"]
    assert [w["dx"] for w in alone["per_window"]] == pytest.approx([w["dx"] for w in mended["per_window"]], abs=1e-3)


def test_a_trajectory_without_a_fault_is_written_as_it_is(street: Path, quick: Path, tmp_path: Path) -> None:
    result = mqslam("audit", street, "-t", "ground_truth", "--config", quick, "--out", tmp_path / "a", "--mend")
    assert result.code == 0 and "nothing to mend" in result.out
    truth, track = read_tum(street / "gt" / "poses_tum.txt"), read_tum(tmp_path / "a" / "mended.tum")
    assert np.abs(track.poses - truth.poses)[:, :2].max() < 1e-5


def test_a_map_that_was_not_judged_is_not_said_to_need_no_mending() -> None:
    untouched = SimpleNamespace(rounds=0)
    assert "nothing to mend" in describe_mended(untouched, {"verdict": {"status": "pass"}})
    assert "could judge too little to mend" in describe_mended(untouched, {"verdict": {"status": "not judged"}})


@pytest.mark.parametrize("stretch", [1.0, 1.028, 0.99])
def test_a_trajectory_that_is_mended_in_its_scale_is_said_to_be(stretch: float) -> None:
    audited = SimpleNamespace(audit=SimpleNamespace(verdict=SimpleNamespace(status="pass")))
    mended = SimpleNamespace(rounds=1, result=audited, is_worse=False, ties=3, loops=1, moved_m=2.45, stretch=stretch)
    sentence = describe_mended(mended, {"verdict": {"status": "fail"}})
    assert sentence.startswith(
        "The trajectory was mended with 3 motions and 1 revisit measured by psi, which moves poses by up to 2.45 m"
    )
    assert (f"makes the path {stretch:.3f} times as long" in sentence) is (stretch != 1.0)


def test_the_trajectory_of_a_cloud_is_mended_and_a_cloud_alone_cannot_be(finished: Path, tmp_path: Path) -> None:
    cloud, track = finished / "map.ply", finished / "trajectory.tum"
    alone = mqslam("audit", cloud, "--out", tmp_path / "a", "--mend", "--quiet")
    assert (
        alone.code == 2 and "map.ply: a cloud without its trajectory cannot be mended; give --trajectory FILE" in alone.err
    )
    assert not (tmp_path / "a").exists()
    result = mqslam("audit", cloud, "--trajectory", track, "--out", tmp_path / "b", "--mend", "--quiet")
    assert (result.code, result.err) == (0, "")
    assert read_tum(tmp_path / "b" / "mended.tum").stamps_us.tolist() == read_tum(track).stamps_us.tolist()


def test_what_is_mended_is_in_the_frame_and_the_clock_of_what_was_given(
    street: Path, bent: Path, quick: Path, tmp_path: Path
) -> None:
    track = read_tum(bent)
    base = se2.compose(track.poses, se2.inverse(np.array([-1.5, 0.4, np.pi / 2])))
    write_tum(tmp_path / "base.tum", Trajectory(track.stamps_us - 3_000_000, base))
    words = ("audit", street, "--config", quick, "--mend", "--quiet")
    assert mqslam(*words, "--trajectory", bent, "--out", tmp_path / "a").code == 0
    mount = "--extrinsics", "-1.5,0.4,90", "--time-offset", "3"
    assert mqslam(*words, "--trajectory", tmp_path / "base.tum", *mount, "--out", tmp_path / "b").code == 0
    sensor, mended = (read_tum(tmp_path / name / "mended.tum") for name in ("a", "b"))
    assert (mended.stamps_us + 3_000_000).tolist() == sensor.stamps_us.tolist()
    apart = se2.between(se2.compose(mended.poses, np.array([-1.5, 0.4, np.pi / 2])), sensor.poses)
    assert np.abs(apart).max() < 1e-3
    again = mqslam("audit", street, "-t", tmp_path / "b" / "mended.tum", *mount, "--config", quick, "--out", tmp_path / "c")
    assert again.code == 0
    alone, before = (json.loads((tmp_path / name / "audit.json").read_text()) for name in ("c", "b"))
    assert alone["verdict"] == before["mended"]["verdict"]


@pytest.mark.slow
@pytest.mark.skipif(not ACES.exists(), reason="the lidar logs are not part of the project")
def test_the_wheels_of_a_real_lidar_log_come_to_agree_where_they_pass_a_place_twice(tmp_path: Path) -> None:
    result = mqslam("audit", ACES, "--trajectory", "odometry", "--out", tmp_path / "a", "--mend", "--json", "-q")
    summary = json.loads(result.out)
    assert summary["verdict"]["status"] == "fail"
    assert summary["revisits"]["torn"] > 0.5 * summary["revisits"]["sure"]
    mended = summary["mended"]
    assert not mended["worse"] and mended["windows"]["torn"] < 0.5 * summary["windows"]["torn"]
    assert mended["revisits"]["sure"] > summary["revisits"]["sure"] and mended["revisits"]["torn"] == 0
