"""`mqslam compare` from the command line: rows of every kind, and files that evo reads as they are."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface
from support.commands import INSTALLED, mqslam, run_in_this_process

from mqslam.core.measurement import Measurement

OPTIONS = ("--odometry-only", "--quiet")


class Dawdler:
    """A front end of somebody's: 2 m straight on per scan."""

    def __init__(self, context) -> None: ...

    def measure(self, scans):
        before = None
        for scan in scans:
            if before is not None:
                yield Measurement(before.t0, scan.t0, np.array([2.0, 0.0, 0.0]), np.eye(3) * 1e-2)
            before = scan


@pytest.fixture
def dawdler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The front end above, installed as a package of its own would be, for child processes too."""
    package = tmp_path / "site"
    info = package / "dawdler-1.0.dist-info"
    info.mkdir(parents=True)
    source = Path(__file__).read_text()
    body = source[source.index("class Dawdler") : source.index("@pytest.fixture")]
    head = "import numpy as np\nfrom mqslam.core.measurement import Measurement\n\n\n"
    (package / "dawdler.py").write_text(head + body)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: dawdler\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[mqslam.frontends]\ndawdler = dawdler:Dawdler\n")
    monkeypatch.syspath_prepend(str(package))
    monkeypatch.setenv("PYTHONPATH", str(package))
    return "dawdler"


@pytest.fixture(scope="module")
def compared(street: Path, quick: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The street by psi, KISS-ICP and its wheels, beside the truth as a given trajectory."""
    out = tmp_path_factory.mktemp("compared") / "out"
    rows = ("--frontends", "psi,kiss_icp,odometry", "--trajectory", f"truth={street / 'gt' / 'poses_tum.txt'}")
    with run_in_this_process():
        result = mqslam("compare", street, "--out", out, *rows, "--config", quick, *OPTIONS)
    assert (result.code, result.err) == (0, "")
    return out


def test_every_row_is_there_with_its_files(compared: Path) -> None:
    rows = {row["name"]: row for row in json.loads((compared / "compare.json").read_text())["rows"]}
    assert list(rows) == ["psi", "kiss_icp", "odometry", "truth"]
    assert all(row["failure"] is None for row in rows.values())
    assert rows["psi"]["ate_rmse_m"] < rows["odometry"]["ate_rmse_m"]
    assert rows["truth"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-4)
    assert 0.1 < rows["psi"]["nees_per_degree"] < 5.0 and rows["truth"]["nees_per_degree"] is None
    assert rows["psi"]["inflation"] < rows["odometry"]["inflation"]
    assert rows["psi"]["ms_per_revolution"] > 0.0 and rows["truth"]["ms_per_revolution"] is None
    names = {"compare.json", "compare.csv", "compare.md", "compare.tex", "report.html", "overlay.png", "config.yaml"}
    assert {path.name for path in compared.iterdir()} == {*names, "run.log", *rows}
    table = list(csv.DictReader((compared / "compare.csv").read_text().splitlines()))
    assert [row["name"] for row in table] == list(rows)
    assert float(table[0]["psi_per_point"]) == pytest.approx(rows["psi"]["psi_per_point"])


def test_diff_lists_the_options_in_which_two_comparisons_differ(compared: Path, tmp_path: Path) -> None:
    other = shutil.copytree(compared, tmp_path / "other")
    log = (other / "run.log").read_text()
    assert log.splitlines()[-1] == json.loads((compared / "compare.json").read_text())["best"]["sentence"]
    (other / "run.log").write_text(log.replace("--odometry-only", "--end 4 --trajectory mine=mine.tum"))
    options = json.loads(mqslam("diff", compared, other, "--json").out)["options"]
    truth = next(word for word in log.split() if word.startswith("truth="))
    trajectories = [[truth], [truth, "mine=mine.tum"]]
    assert options == {"odometry_only": [True, None], "end": [None, "4"], "trajectory": trajectories}
    assert "odometry_only  true -> not given\n" in mqslam("diff", compared, other).out


def test_diff_compares_the_rows_of_two_comparisons_by_their_names(compared: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(compared, tmp_path / "other"))
    summary = json.loads((compared / "compare.json").read_text())
    first = summary["rows"][0]
    before = first["ate_rmse_m"]
    first |= {"ate_rmse_m": 12.5, "measure_s": 1e6, "psi_across_passes": 7.0}
    (other / "compare.json").write_text(json.dumps(summary))
    found = json.loads(mqslam("diff", compared, other, "--json").out)
    at = f"rows.{first['name']}"
    assert found["figures"] == {f"{at}.ate_rmse_m": [before, 12.5], f"{at}.psi_across_passes": [None, 7.0]}
    assert found["trajectories"] is None
    shown = mqslam("diff", compared, other).out
    assert f"{at}.ate_rmse_m" in shown and "-> 12.5" in shown
    assert shown.endswith("trajectories: not compared, because every row of a comparison has its own trajectory\n")


def test_evo_reads_the_trajectories_and_finds_the_same_errors(compared: Path, street: Path) -> None:
    truth = file_interface.read_tum_trajectory_file(str(street / "gt" / "poses_tum.txt"))
    for row in json.loads((compared / "compare.json").read_text())["rows"][:3]:
        track = file_interface.read_tum_trajectory_file(str(compared / row["name"] / "trajectory.tum"))
        poses = file_interface.read_kitti_poses_file(str(compared / row["name"] / "trajectory.kitti"))
        np.testing.assert_allclose(poses.positions_xyz, track.positions_xyz, atol=1e-5)
        assert len((compared / row["name"] / "times.txt").read_text().splitlines()) == len(track.timestamps)
        reference, estimate = sync.associate_trajectories(truth, track)
        estimate.align(reference)
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data((reference, estimate))
        assert row["ate_rmse_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=2e-4)
        _, unaligned = sync.associate_trajectories(truth, track)
        rpe = metrics.RPE(metrics.PoseRelation.rotation_angle_rad, delta=1, delta_unit=metrics.Unit.frames)
        rpe.process_data((reference, unaligned))
        per_step = row["rpe_w_rms"] * 0.25
        assert per_step == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=0.02, abs=1e-5)


def test_a_front_end_of_ones_own_is_a_row(street: Path, quick: Path, tmp_path: Path, dawdler: str) -> None:
    out = tmp_path / "out"
    rows = ("--frontends", f"{dawdler},kiss_icp")
    result = mqslam("compare", street, "--out", out, *rows, "--config", quick, *OPTIONS)
    assert (result.code, result.err) == (0, "")
    rows = {row["name"]: row for row in json.loads((out / "compare.json").read_text())["rows"]}
    assert rows[dawdler]["failure"] is None
    xy = np.loadtxt(out / dawdler / "trajectory.tum")[:, 1:3]
    np.testing.assert_allclose(np.diff(xy, axis=0), np.tile([2.0, 0.0], (len(xy) - 1, 1)), atol=1e-6)
    assert rows["kiss_icp"]["rpe_w_rms"] < rows[dawdler]["rpe_w_rms"]


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_the_last_line_names_the_best_row_and_the_table_marks_the_best_values(
    street: Path, quick: Path, tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    out, truth = tmp_path / "out", street / "gt" / "poses_tum.txt"
    rows = ("--frontends", "odometry,kiss_icp", "--odometry", "none", "--trajectory", f"truth={truth}")
    words = [str(INSTALLED), "compare", street, "--out", out, *rows, "--config", quick, "--odometry-only"]
    result = subprocess.run(list(map(str, words)), capture_output=True, check=True)
    lines = result.stdout.decode(encoding).splitlines()
    best = json.loads((out / "compare.json").read_text())["best"]
    assert (best["rows"], best["decided_by"]) == (["truth"], "ATE")
    assert lines[-1] == best["sentence"] and lines[-1].startswith("truth is best: its ATE is 0.000 m, against 0.")
    less = {"utf-8": "↓", "ascii": "v"}[encoding]
    (ate,) = (line for line in lines if line.startswith(f"ATE [m] {less}"))
    assert ate.count("*") == 1 and "* 0.000" in ate
    assert any(line.startswith(f"* is the best value; {less} less is better") for line in lines)
    assert "odometry" not in best["sentence"] and any(line.startswith("odometry failed") for line in lines)


def test_a_trajectory_that_lacks_scans_is_named_below_the_tables(street: Path, quick: Path, tmp_path: Path) -> None:
    out, part = tmp_path / "out", tmp_path / "part.tum"
    part.write_text("".join((street / "gt" / "poses_tum.txt").read_text().splitlines(keepends=True)[:-5]))
    rows = ("--frontends", "odometry", "--trajectory", f"part={part}")
    result = mqslam("compare", street, "--out", out, *rows, "--config", quick, *OPTIONS[:1])
    summary = json.loads((out / "compare.json").read_text())
    scans, compared = (summary["dataset"][name] for name in ("revolutions", "compared"))
    assert [row["scans"] for row in summary["rows"]] == [scans, compared] and compared < scans
    note = f"Of {scans} scans, part covers {compared}; every row is judged on the {compared} that all rows cover.\n"
    assert note in result.out and f"- {note}" in (out / "compare.md").read_text()
    assert f"% {note}" in (out / "compare.tex").read_text()
    summary["warnings"].append("a warning for everybody")
    (out / "compare.json").write_text(json.dumps(summary))
    assert mqslam("show", out).err == "warning: a warning for everybody\n"


def test_one_row_ends_without_a_winner(street: Path, quick: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = mqslam("compare", street, "--out", out, "--frontends", "odometry", "--config", quick, "--odometry-only")
    assert json.loads((out / "compare.json").read_text())["best"] is None
    assert result.out.splitlines()[-1].startswith("results in ") and "*" not in result.out


@pytest.mark.slow
def test_a_row_that_cannot_run_says_why_and_the_others_go_on(oxford_tiny: Path, tmp_path: Path) -> None:
    result = mqslam("compare", oxford_tiny, "--out", tmp_path / "out", "--odometry-only")
    assert result.code == 0
    rows = {row["name"]: row for row in json.loads((tmp_path / "out" / "compare.json").read_text())["rows"]}
    assert list(rows) == ["psi", "kiss_icp", "open3d_icp", "odometry"]
    assert "needs odometry" in rows["odometry"]["failure"] and "odometry failed: " in result.out
    for name in ("psi", "kiss_icp", "open3d_icp"):
        assert rows[name]["failure"] is None and rows[name]["rpe_v_rms"] < 0.5
