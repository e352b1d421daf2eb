"""Results are read, shown, compared and drawn again from their folders: `mqslam show`, `diff` and `plot`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.commands import mqslam, parse_strict_json

import mqslam as package
from mqslam.commands.result import AuditResult, BatchResult, CompareResult, LocaliseResult, MergeResult, RunResult
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.execution.folders import CHECKPOINT
from mqslam.formats.tum import read_tum, write_tum
from mqslam.report.canvas import BLUE, PURPLE
from mqslam.results.batch_results import OPTIONS, check_batch, write_batch, write_progress


def test_a_run_is_read_again_as_the_command_returned_it(finished: Path) -> None:
    result = package.read_result(str(finished))
    assert isinstance(result, RunResult) and result.folder == finished
    assert result.summary == json.loads((finished / "summary.json").read_text())
    assert result.read_config() == package.load_config(finished / "config.yaml")
    assert len(result.read_trajectory()) == result.summary["dataset"]["revolutions"]


def test_a_result_is_short_in_a_console_and_a_table_in_a_notebook(finished: Path, tmp_path: Path) -> None:
    result = package.read_result(finished)
    assert repr(result).startswith(f"<RunResult '{finished}', {result.verdict}, ") and len(repr(result)) < 200
    table = result._repr_html_()
    assert f"<th>verdict</th><td>{result.verdict}: " in table and f'href="{result.report}"' in table
    shutil.copytree(finished, tmp_path / "hostile")
    summary = result.summary | {"verdict": result.summary["verdict"] | {"diagnosis": "<script>"}}
    (tmp_path / "hostile" / "summary.json").write_text(json.dumps(summary))
    assert "<script>" not in package.read_result(tmp_path / "hostile")._repr_html_()


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("audit.json", {}, AuditResult),
        ("batch.json", {"runs": []}, BatchResult),
        ("compare.json", {"rows": [], "best": None}, CompareResult),
        ("summary.json", {"recordings": []}, MergeResult),
        ("summary.json", {"median_sigma": {}}, LocaliseResult),
        ("summary.json", {}, RunResult),
    ],
)
def test_the_kind_of_a_result_follows_from_its_files(name: str, content: dict, kind: type, tmp_path: Path) -> None:
    (tmp_path / name).write_text(json.dumps({"warnings": [], **content}))
    result = package.read_result(tmp_path)
    assert type(result) is kind and result.warnings == [] and repr(result).startswith(f"<{kind.__name__} ")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"warnings": [], ', "[" * 100_000])
def test_a_damaged_summary_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "compare.json").write_text(text)
    with pytest.raises(DataError, match="give the folder of a result"):
        package.read_result(tmp_path)
    shown = mqslam("show", tmp_path)
    assert shown.code == 2 and shown.err.startswith(f"mqslam: error: {tmp_path / 'compare.json'}: ")


@pytest.mark.parametrize("command", ["show", "plot"])
def test_a_folder_without_a_result_is_refused(command: str, tmp_path: Path) -> None:
    shown = mqslam(command, tmp_path)
    assert shown.code == 2 and "holds no result (summary.json" in shown.err


def test_show_says_why_there_is_no_result(finished: Path, tmp_path: Path) -> None:
    def refuse(path: Path) -> str:
        shown = mqslam("show", path)
        assert shown.code == 2
        return shown.err

    assert f"{tmp_path / 'none'}: does not exist; check the path" in refuse(tmp_path / "none")
    assert "summary.json: is a file; give the folder of a result" in refuse(finished / "summary.json")
    assert f"{finished.parent}: holds no result (" in refuse(finished.parent)
    assert f"; give a folder in it that holds a result, such as {finished.name}" in refuse(finished.parent)


def test_a_batch_that_was_killed_is_called_unfinished(finished: Path, tmp_path: Path) -> None:
    check_batch(tmp_path / "out", force=False)
    write_progress(tmp_path / "out", [], [])
    shown = mqslam("plot", tmp_path / "out")
    problem = f"mqslam: error: {tmp_path / 'out'}: holds work that is not finished, and no result yet; "
    assert shown.code == 2 and shown.err == f"{problem}wait until the work has ended, or repeat its command\n"
    shutil.copytree(finished, tmp_path / "out" / "drive")
    with pytest.raises(DataError, match="or repeat its command, or give a folder in it that holds a result, such as drive"):
        package.read_result(tmp_path / "out")
    write_batch(tmp_path / "out", {"warnings": [], "runs": []})
    assert isinstance(package.read_result(tmp_path / "out"), BatchResult)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"batch.json", "batch.csv", "drive"}


def test_an_unfinished_result_is_neither_suggested_nor_opened(finished: Path, tmp_path: Path) -> None:
    for name in (".out.unfinished", ".out.unfinished.1", ".a.replaced", "later"):
        shutil.copytree(finished, tmp_path / name)
    (tmp_path / "earlier").mkdir()
    shutil.copy(finished / "summary.json", tmp_path / "earlier" / "audit.json")
    shown = mqslam("show", tmp_path)
    assert shown.code == 2 and "; give a folder in it that holds a result, such as earlier\n" in shown.err
    for name in (".out.unfinished", ".out.unfinished.1"):
        shown = mqslam("show", tmp_path / name)
        problem = "holds an incomplete result, which was to become out; wait until the work has ended, or repeat its"
        assert shown.code == 2 and shown.err.endswith(f"{name}: {problem} command\n")
        with pytest.raises(DataError, match="holds an incomplete result"):
            package.read_result(tmp_path / name)
    (tmp_path / "out" / CHECKPOINT).mkdir(parents=True)
    shown = mqslam("show", tmp_path / ".out.unfinished")
    assert "or repeat its command and continue with --resume\n" in shown.err


def test_show_prints_what_the_run_printed(finished: Path) -> None:
    shown = mqslam("show", finished)
    assert shown.code == 0
    assert "psi per point" in shown.out and f"report: {finished / 'report.html'}" in shown.out and "verdict: " in shown.out
    assert parse_strict_json(mqslam("show", finished, "--json").out) == package.read_result(finished).summary


def test_diff_lists_settings_figures_and_distances(finished: Path, other: Path) -> None:
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert found["settings"] == {"detector.threshold": [40.0, 60.0]}
    assert found["figures"] == {"frontend": ["odometry", "other"]}
    apart, poses = found["trajectories"], read_tum(finished / "trajectory.tum").poses
    far = np.hypot(*(se2.compose([0.0, 3.0, 0.1], poses) - poses)[:, :2].T)
    assert apart["stamps"] == len(poses) and apart["as_they_are"]["largest_m"] == pytest.approx(far.max(), abs=1e-5)
    assert apart["as_they_are"]["largest_rad"] == pytest.approx(0.1, abs=1e-6)
    assert apart["aligned"]["largest_m"] < 1e-4 and apart["aligned"]["largest_rad"] < 1e-5
    shown = mqslam("diff", finished, other).out
    assert "detector.threshold  40 -> 60" in shown and "frontend  odometry -> other" in shown
    assert f"as they are  {far.max():.3f} m apart at most" in shown and "aligned      0.000 m apart" in shown


def test_diff_lists_the_options_that_differ(finished: Path, other: Path) -> None:
    log = (other / "run.log").read_text()
    assert "--frontend odometry" in log
    (other / "run.log").write_text(log.replace("--frontend odometry", "--start 2 --extrinsics=-1,0,0 --strict -j 3"))
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)["options"]
    expected = {"start": [None, "2"], "extrinsics": [None, "-1,0,0"], "strict": [None, True]}
    assert found == {"frontend": ["odometry", None], **expected}
    assert "start       not given -> 2" in mqslam("diff", finished, other).out
    (other / "run.log").write_text(log.replace("command: mqslam run", "command: steps.py run"))
    assert parse_strict_json(mqslam("diff", finished, other, "--json").out)["options"] == {}
    (other / "run.log").write_text(log.replace("command: mqslam run", "command: steps.py"))
    unknown = f"options: not known, because run.log of {other} holds"
    assert mqslam("diff", finished, other).out.startswith(f"{unknown} no command of mqslam\n")
    (other / "run.log").write_text(log.replace("command: mqslam run", "command: mqslam batch"))
    reason = "the command of a batch, which does not state the options of its runs"
    assert mqslam("diff", other, finished).out.startswith(f"{unknown} {reason}\n")
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert found["options"] is None and found["options_not_known"] == f"run.log of {other} holds {reason}"


def test_diff_says_why_psi_does_not_compare(finished: Path, other: Path) -> None:
    summary = json.loads((other / "summary.json").read_text())
    summary["psi"]["per_point_optimised"] *= 2.0
    (other / "summary.json").write_text(json.dumps(summary))
    shown = mqslam("diff", finished, other).out
    assert "psi.per_point" not in shown
    reason = "the maps are made or scored by different settings (detector.threshold)"
    assert f"psi: not compared, because {reason}; psi compares maps of the same returns\n" in shown
    settings = (finished / "config.yaml").read_text()
    (other / "config.yaml").write_text(settings.replace("clockwise: null", "clockwise: true"))
    reason = "only one of the results states sensor.clockwise: the other took it from the recording, or a default"
    assert f"psi: not compared, because {reason}; psi compares" in mqslam("diff", finished, other).out
    shutil.copy(finished / "config.yaml", other)
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert found["psi_not_compared"] is None and "psi.per_point_optimised" in found["figures"]
    summary["dataset"]["points"] += 1
    (other / "summary.json").write_text(json.dumps(summary))
    assert "psi: not compared, because the maps are of different scans; psi compares" in mqslam("diff", finished, other).out
    del summary["dataset"]["points"]  # as in results of earlier versions
    (other / "summary.json").write_text(json.dumps(summary))
    assert parse_strict_json(mqslam("diff", finished, other, "--json").out)["psi_not_compared"] is None
    shutil.copy(finished / "summary.json", other)
    track = read_tum(other / "trajectory.tum")
    (other / "trajectory.tum").unlink()
    write_tum(other / "trajectory.tum", Trajectory(track.stamps_us[1:], track.poses[1:]))
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert (
        found["psi_not_compared"] == "the maps are of different scans" and "psi.per_point_optimised" not in found["figures"]
    )


def test_diff_of_a_result_with_itself_is_empty(finished: Path) -> None:
    shown = mqslam("diff", finished, finished).out
    assert "options: the same\nsettings: the same\nfigures: the same\n" in shown and "as they are  0.000 m apart" in shown


def test_diff_says_that_other_figures_differ_where_the_main_ones_are_the_same(finished: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(finished, copy)
    summary = json.loads((copy / "summary.json").read_text()) | {"doppler_beta": 0.5}
    (copy / "summary.json").write_text(json.dumps(summary))
    shown = mqslam("diff", finished, copy).out
    assert "main figures: the same\nother figures: 1 difference, which --json lists\n" in shown


def test_diff_compares_results_of_versions_with_other_settings(finished: Path, other: Path) -> None:
    settings = (other / "config.yaml").read_text()
    (other / "config.yaml").write_text(settings + "former:\n  setting: 3\n")
    found = parse_strict_json(mqslam("diff", finished, other, "--json").out)
    assert found["settings"]["former.setting"] == [None, 3]


def test_diff_shows_first_which_tests_changed(finished: Path, other: Path) -> None:
    summary = json.loads((other / "summary.json").read_text())
    name = next(iter(summary["tests"]))
    summary["tests"][name]["status"] = "changed"
    (other / "summary.json").write_text(json.dumps(summary))
    assert f"figures\ntests.{name}.status" in mqslam("diff", finished, other).out


def test_diff_refuses_results_of_different_kinds(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "audit.json").write_text('{"warnings": []}')
    shown = mqslam("diff", finished, tmp_path)
    assert shown.code == 2 and f"is the result of another command than {finished} (audit, not run)" in shown.err


def test_a_batch_lists_the_verdicts_of_its_runs_and_reads_their_results(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / "drive")
    rows = [("bad", None, "is no recording"), ("drive", "warn", None), *((f"later {k}", "pass", None) for k in range(9))]
    runs = [{"name": name, "verdict": verdict, "failure": failure} for name, verdict, failure in rows]
    (tmp_path / "batch.json").write_text(json.dumps({"warnings": [], "runs": runs}))
    result = package.read_result(tmp_path)
    assert isinstance(result, BatchResult)
    runs_in_words = "1 failed (bad), 1 warn (drive), 9 pass (later 0, later 1, later 2, later 3, later 4, ...)"
    assert repr(result) == f"<BatchResult '{tmp_path}', {runs_in_words}>"
    assert f"<th>runs</th><td>{runs_in_words}</td>" in result._repr_html_()
    assert list(result.verdicts.items())[:3] == [("bad", None), ("drive", "warn"), ("later 0", "pass")]
    assert result.read_run("drive").summary == package.read_result(finished).summary
    with pytest.raises(DataError, match="bad: holds no result, because the run failed: is no recording"):
        result.read_run("bad")
    with pytest.raises(ConfigError, match=r"has no run 'Drive 1'; did you mean drive\?"):
        result.read_run("Drive 1")


def test_diff_names_the_runs_of_two_batches_that_differ(finished: Path, other: Path, tmp_path: Path) -> None:
    run = dict.fromkeys(OPTIONS) | {"frontend": "psi", "imu": "auto", "verdict": "pass"}
    own = [run | {"name": name, "data": f"/{name}"} for name in ("drive", "same", "settings", "mon")]
    others = [own[0] | {"frontend": "odometry", "end": 4.0, "verdict": None}, *own[1:3], own[3] | {"name": "fri"}]
    for batch, runs, folder in (("one", own, finished), ("two", others, other)):
        for name in ("drive", "same", "settings"):
            shutil.copytree(folder if name != "same" else finished, tmp_path / batch / name)
        (tmp_path / batch / "batch.json").write_text(json.dumps({"warnings": [], "runs": runs}))
    found = parse_strict_json(mqslam("diff", tmp_path / "one", tmp_path / "two", "--json").out)
    threshold = {"detector.threshold": [40.0, 60.0]}
    assert found["entries"]["drive"] == {"frontend": ["psi", "odometry"], "end": [None, 4.0], **threshold}
    assert found["entries"]["settings"] == threshold and found["verdicts"] == {"drive": ["pass", None]}
    assert found["entries"]["mon"] == {"data": ["/mon", None]} and found["entries"]["fri"] == {"data": [None, "/mon"]}
    assert "same" not in found["entries"]
    shown = mqslam("diff", tmp_path / "one", tmp_path / "two").out
    assert "drive     frontend: psi -> odometry\n          end: not given -> 4\n" in shown
    assert "verdicts of runs\ndrive     pass -> failed\n" in shown
    assert mqslam("diff", tmp_path / "one", tmp_path / "one").out.startswith("options and settings of runs: the same\n")
    of_runs = parse_strict_json(mqslam("diff", tmp_path / "one" / "drive", tmp_path / "two" / "drive", "--json").out)
    assert of_runs["options"] == {"frontend": ["psi", "odometry"], "end": [None, 4.0]}


@pytest.mark.parametrize(("suffix", "begin"), [(".pdf", b"%PDF"), (".png", b"\x89PNG"), (".svg", b"<?xml")])
def test_plot_draws_map_error_and_covariance(suffix: str, begin: bytes, finished: Path, tmp_path: Path) -> None:
    first, second = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    for out in (first, second):
        shown = mqslam("plot", finished, "--out", out)
        assert (shown.code, shown.out, shown.err) == (0, f"{out}\n", "")
    content = first.read_bytes()
    assert content.startswith(begin) and content == second.read_bytes()
    if suffix == ".svg":
        words = content.decode()
        assert all(word in words for word in ("ground truth", "path", "3σ ellipses", "error [m]", "1σ across", "<image"))
        assert 0 < words.index(f"stroke: {PURPLE}") < words.index(f"stroke: {BLUE}")  # the path lies over the ellipses
    if suffix == ".png":
        with Image.open(first) as image:
            assert image.height > image.width and np.asarray(image.convert("L")).std() > 10.0
            rows, columns = np.nonzero(np.asarray(image.convert("L")) < 250)
            margins = [rows.min(), columns.min(), image.height - 1 - rows.max(), image.width - 1 - columns.max()]
        assert min(margins) > 0 and max(margins) < 30  # pixels, 200 of which are an inch: no label is cut, no space is empty


def test_plot_leaves_out_what_is_not_there(finished: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(finished, bare)
    for name in ("ground_truth.tum", "covariances.csv", "map.ply"):
        (bare / name).unlink()
    assert mqslam("plot", bare, "--out", tmp_path / "bare.svg").code == 0
    words = (tmp_path / "bare.svg").read_text()
    assert "path" in words and not any(word in words for word in ("truth", "ellipses", "error", "1σ"))
    (bare / "trajectory.tum").unlink()
    shown = mqslam("plot", bare, "--out", tmp_path / "none.svg")
    assert shown.code == 2 and "holds no trajectory.tum to draw" in shown.err and not (tmp_path / "none.svg").exists()


def test_plot_refuses_other_pictures_and_files_that_exist(finished: Path, tmp_path: Path) -> None:
    shown = mqslam("plot", finished, "--out", tmp_path / "map.jpg")
    assert shown.code == 2 and "end its name in .pdf, .png, .svg" in shown.err
    shown = mqslam("plot", finished, "--out", tmp_path / "none" / "map.svg")
    assert shown.code == 2 and f"because the folder {tmp_path / 'none'} does not exist; choose another --out" in shown.err
    (tmp_path / "map.svg").write_text("mine")
    shown = mqslam("plot", finished, "--out", tmp_path / "map.svg")
    assert shown.code == 2 and "exists already; choose another --out or give --force to replace it" in shown.err
    assert (tmp_path / "map.svg").read_text() == "mine"
    assert mqslam("plot", finished, "--out", tmp_path / "map.svg", "--force").code == 0
