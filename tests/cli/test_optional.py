"""What results can do without may fail in any way: it costs itself alone, and the command says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from support.commands import Result, mqslam, read_summary

from mqslam.auditing.verdict import VerdictStatus
from mqslam.cli.options import choose_exit_code
from mqslam.config import Config, load_config
from mqslam.core import frontend
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.core.sensors import Inputs
from mqslam.core.trajectory import Trajectory
from mqslam.execution.checkpoint import hash_run
from mqslam.execution.folders import CHECKPOINT
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.report.batch_page import write_batch_page
from mqslam.results.batch_results import Order, RunOutcome, summarise, write_batch
from mqslam.results.files import add_warnings
from mqslam.simulator import SensorModel, simulate

ESSENTIAL = {"trajectory.tum", "odometry.tum", "measurements.csv", "config.yaml", "summary.json", "run.log"}
NAMES = "covariances.csv graph.g2o graph.csv map.ply map.pgm map.yaml keyframes report.html ground_truth.tum"
OTHERS = set(NAMES.split())


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five coarse seconds of a street with its wheels, and settings that leave nothing to be measured beforehand."""
    folder = tmp_path_factory.mktemp("optional")
    simulate(
        folder / "drive", duration_s=5.0, sensor=SensorModel(azimuths=200, range_resolution=0.35, max_range=60.0), movers=0
    )
    (folder / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    return folder / "drive"


def run(drive: Path, out: Path, *more: str | Path) -> Result:
    """Runs a drive by odometry alone, which takes no time, unless the test asks for something else."""
    chosen = more or ("--frontend", "odometry")
    alone = ("--imu", "none", "--gnss", "none", "--jobs", "1")
    return mqslam("run", drive, "--out", out, "--config", drive.with_name("quick.yaml"), *alone, *chosen)


def failing(error: Exception) -> Callable[..., Any]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def assert_said(shown: Result, out: Path, *warnings: str) -> None:
    """Checks that every warning is on stderr, in the log and in the summary, where a terminal breaks no line."""
    for warning in warnings:
        assert f"warning: {warning}" in shown.err.splitlines()
        assert f"warning: {warning}" in (out / "run.log").read_text().splitlines()
        assert warning in read_summary(out)["warnings"]


def test_files_that_cannot_be_made_cost_no_other(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("write_covariances", "format_g2o", "write_ply", "write_nav2_map"):
        monkeypatch.setattr(f"mqslam.results.run_results.{name}", failing(MemoryError()))
    monkeypatch.setattr("mqslam.report.page._environment", failing(MemoryError()))
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == ESSENTIAL | {"ground_truth.tum", "keyframes"}
    lost = ("covariances.csv", "graph.g2o", "map.ply", "map.pgm", "report.html")
    said = (f"{name} could not be completed (MemoryError); the other results are complete" for name in lost)
    assert_said(shown, tmp_path / "out", *said)


def test_a_map_its_check_and_loops_that_fail_cost_no_trajectory(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqslam.mapping.render.render", failing(MemoryError("Unable to allocate 40 GiB")))
    monkeypatch.setattr("mqslam.slam.audit_trajectory", failing(np.linalg.LinAlgError("Singular matrix")))
    monkeypatch.setattr("mqslam.slam.find_loops", failing(ValueError("by nothing")))
    out = tmp_path / "out"
    shown = run(drive, out)
    assert shown.code == 0
    assert {path.name for path in out.iterdir()} == ESSENTIAL | OTHERS
    whole = "; the other results are complete"
    assert_said(
        shown,
        out,
        f"the search for loops could not be completed (ValueError: by nothing){whole}",
        f"the map before optimisation could not be completed (MemoryError: Unable to allocate 40 GiB){whole}",
        f"the map could not be completed (MemoryError: Unable to allocate 40 GiB){whole}",
        f"the check of the map could not be completed (LinAlgError: Singular matrix){whole}",
    )
    summary = read_summary(out)
    assert summary["psi"]["per_point_optimised"] is None and summary["inflation"]["median"] is None
    assert summary["verdict"]["status"] == "not judged"
    crashed = "the check of the map crashed (LinAlgError: Singular matrix), so that nothing has judged the map"
    assert summary["verdict"]["reasons"][0].startswith(crashed)
    assert not any("no window" in reason or "too few" in reason for reason in summary["verdict"]["reasons"])
    assert "Numbers" in (out / "report.html").read_text()
    assert len(summary["warnings"]) == 4  # an empty map makes a page like any other


def test_a_full_disk_is_an_error_all_the_same(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mqslam.results.run_results.write_ply", failing(OSError(28, "No space left on device")))
    monkeypatch.setattr("mqslam.execution.files.tempfile.mkstemp", failing(OSError(28, "No space left on device")))
    shown = run(drive, tmp_path / "out")
    assert shown.code == 2 and "No space left on device" in shown.err
    assert not (tmp_path / "out" / "trajectory.tum").exists()


def test_covariances_that_cannot_be_had_are_a_warning(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failure = "MemoryError: Unable to allocate 40 GiB"
    monkeypatch.setattr("mqslam.backend.elimination.eliminate", failing(MemoryError("Unable to allocate 40 GiB")))

    def write_indices(folder: Path, result: Any, *_: Any) -> list[str]:
        (folder / "report.html").write_text(str(result.covariances))
        return []

    monkeypatch.setattr("mqslam.commands.run.write_run_page", write_indices)
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    said = f"the covariances of the poses are not known ({failure}): results and report do not contain them"
    assert {path.name for path in (tmp_path / "out").iterdir()} == (ESSENTIAL | OTHERS) - {"covariances.csv"}
    assert_said(shown, tmp_path / "out", said)
    assert failure in (tmp_path / "out" / "report.html").read_text()


def test_a_graph_that_cannot_be_optimised_leaves_the_front_ends_motions(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqslam.backend.pose_graph.gtsam.LevenbergMarquardtOptimizer", failing(RuntimeError("no luck")))
    monkeypatch.setattr("mqslam.commands.run.write_run_page", lambda *_: [])
    shown = run(drive, tmp_path / "out")
    assert shown.code == 0
    said = "the pose graph could not be optimised (RuntimeError: no luck): its starting values are kept"
    assert_said(shown, tmp_path / "out", said)
    verdict = read_summary(tmp_path / "out")["verdict"]
    assert verdict["status"] == "fail" and "could not be optimised" in verdict["reasons"][0]
    kept = [np.loadtxt(tmp_path / "out" / name)[:, 1:] for name in ("trajectory.tum", "odometry.tum")]
    np.testing.assert_array_equal(*kept)


def test_a_run_that_died_writing_can_be_resumed_by_a_later_version(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As runs through a tunnel died: all was computed, and the results could not be written."""
    out, asked = tmp_path / "out", ("--odometry", "none")
    with monkeypatch.context() as patch:
        patch.setattr("mqslam.commands.run.write_run", failing(RuntimeError("Indeterminate linear system")))
        with pytest.raises(RuntimeError):
            run(drive, out, *asked)
    assert {path.name for path in out.iterdir()} == {CHECKPOINT}
    monkeypatch.setattr("mqslam.slam.frontends.load", lambda _: lambda context: None)  # nothing is measured again
    assert run(drive, out, *asked, "--resume").code == 0
    assert {path.name for path in out.iterdir()} == ESSENTIAL | OTHERS


def test_other_bounds_of_the_verdict_make_another_run(drive: Path) -> None:
    recording, usual = open_recording(drive), load_config(drive.with_name("quick.yaml"))
    strict = usual.model_copy(update={"verdict": usual.verdict.model_copy(update={"false_alarms": 0.02})})
    assert hash_run(recording, usual, "psi", None) != hash_run(recording, strict, "psi", None)


class Broken:
    """A front end of somebody's whose numbers are none."""

    fault = ""

    def __init__(self, context: Context) -> None: ...

    def measure(self, scans: list[Scan]) -> Iterator[Measurement]:
        for k, (a, b) in enumerate(pairwise(scans)):
            pose, covariance = np.zeros(3), 1e-2 * np.eye(3)
            if k == 5 and self.fault == "pose":
                pose[0] = np.nan
            elif k == 5 and self.fault == "covariance":
                covariance[1, 1] = -1.0
            elif k == 5 and self.fault == "number":
                return
            elif k == 5 and self.fault == "shape":
                covariance = np.eye(2)
            elif k == 5 and self.fault == "exception":
                raise KeyError("ranges")
            elif k == 5 and self.fault == "nothing":
                yield None
            elif k == 5 and self.fault == "status":
                yield Measurement(a.t0, b.t0, pose, covariance, status="lost")
            elif k == 5 and self.fault == "swapped":
                yield Measurement(b.t0, a.t0, pose, covariance)
            elif k == 5 and self.fault == "microseconds":
                yield Measurement(1e6 * a.t0, 1e6 * b.t0, pose, covariance)
            yield Measurement(a.t0, b.t0, pose, covariance)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (
            "pose",
            "stopped with ValueError: the motion from 1.25 s to 1.50 s has a pose or a covariance that is not a number",
        ),
        ("covariance", "stopped with ValueError: the motion from 1.25 s to 1.50 s has a covariance with negative variances"),
        ("number", "gave 5 motions for 20 scans"),
        ("shape", "stopped with ValueError: the motion from 1.25 s to 1.50 s has a pose of shape (3,) and a covariance"),
        ("nothing", "gave an object of type NoneType; it must give a mqslam.Measurement for every pair of scans"),
        ("status", "gave a motion the status 'lost'; it must be a mqslam.Status, such as Status.LOST"),
        (
            "swapped",
            "gave a motion from 1.5 s to 1.25 s for the scans that start at 1.25 s and 1.5 s; its t0 and t1 must be",
        ),
        ("microseconds", "gave a motion from 1.25e+06 s to 1.5e+06 s for the scans that start at 1.25 s and 1.5 s;"),
        ("exception", "stopped with KeyError: 'ranges'; mend it (-v shows its traceback)"),
    ],
)
def test_a_front_end_whose_numbers_are_none_is_named(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, said: str
) -> None:
    monkeypatch.setattr(frontend, "load", lambda _: Broken)
    monkeypatch.setattr(Broken, "fault", fault)
    shown = run(drive, tmp_path / "out", "--quiet")
    assert shown.code == 2 and shown.err.startswith(f"mqslam: error: front end psi: {said}") and shown.err.count("\n") == 1


def test_one_scan_has_a_pose_and_no_verdict(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a front end that minds no more than ours do about a single scan, and with wheels."""
    load = frontend.load
    monkeypatch.setattr(frontend, "load", lambda name: Broken if name == "psi" else load(name))
    monkeypatch.setattr("mqslam.commands.run.write_run_page", lambda *_: [])
    one = tmp_path / "one"
    shutil.copytree(drive, one)
    for image in sorted((one / "radar").glob("*.png"))[1:]:
        image.unlink()
    (one / "radar.timestamps").write_text((drive / "radar.timestamps").read_text().splitlines(keepends=True)[0])
    shutil.copy(drive.with_name("quick.yaml"), tmp_path)
    assert run(one, tmp_path / "out", "--odometry", "auto").code == 0
    assert read_summary(tmp_path / "out")["verdict"] == {
        "status": "not judged",
        "diagnosis": "1 scan is too few to judge a map by: a window takes 6",
        "reasons": ["1 scan is too few to judge a map by: a window takes 6"],
    }


def test_an_audit_keeps_its_numbers_without_pictures_and_report(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("audit_page.write_bytes", "page._environment"):
        monkeypatch.setattr(f"mqslam.report.{name}", failing(ValueError("by nothing")))
    shown = mqslam("audit", drive, "--trajectory", "ground_truth", "--out", tmp_path / "out", "--fail-on", "fail")
    assert shown.code == 3 and shown.out.startswith("verdict       not judged: 0 of 4 windows are torn, too few to judge")
    names = "config.yaml run.log audit.csv steps.csv spans.csv revisits.csv bad_places.csv bad_places.geojson"
    names += " audit.json audit.md junit.xml"
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(names.split())
    said = [
        f"{name} could not be completed (ValueError: by nothing); the other results are complete"
        for name in ("heatmap.png", "report.html")
    ]
    assert read_summary(tmp_path / "out", "audit.json")["warnings"] == said
    assert [line for line in shown.err.splitlines() if "could not" in line] == [f"note: {line}" for line in said]


@pytest.mark.parametrize(("fail_on", "codes"), [("warn", [0, 1, 1, 3]), ("fail", [0, 0, 1, 3])])
def test_a_map_that_could_not_be_judged_has_an_exit_code_of_its_own(
    fail_on: Literal["warn", "fail"], codes: list[int]
) -> None:
    assert [choose_exit_code(VerdictStatus(status), fail_on) for status in ("pass", "warn", "fail", "not judged")] == codes


def test_a_comparison_keeps_what_does_not_fail(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mqslam.comparison import judgement as judge

    evaluate = judge.audit
    calls: list[int] = []

    def once(*arguments: Any) -> Any:
        calls.append(1)
        return evaluate(*arguments) if len(calls) > 1 else failing(np.linalg.LinAlgError("Singular matrix"))()

    monkeypatch.setattr(judge, "audit", once)
    for name in ("compare_page.write_bytes", "page._environment"):
        monkeypatch.setattr(f"mqslam.report.{name}", failing(ValueError("by nothing")))
    given = ("--frontends", "odometry", "--odometry-only", "--trajectory", f"first={drive / 'gt' / 'poses_tum.txt'}")
    shown = mqslam("compare", drive, "--out", tmp_path / "out", *given)
    assert shown.code == 0
    names = {"compare.csv", "compare.md", "compare.tex", "compare.json", "config.yaml", "run.log", "odometry", "first"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    summary = read_summary(tmp_path / "out", "compare.json")
    rows = {row["name"]: row for row in summary["rows"]}
    assert rows["odometry"]["failure"] is not None and "Singular matrix" in rows["odometry"]["failure"]
    assert rows["first"]["verdict"] == "not judged" and "too few to judge" in rows["first"]["reasons"]
    assert rows["first"]["windows_torn"] == 0.0 and rows["first"]["windows_torn_at_most"] > 0.5
    assert [w for w in summary["warnings"] if w.startswith(("overlay.png could not", "report.html could not"))]
    assert "failed: the judgement of its map" in shown.out and "not judged" in shown.out
    assert "warning: report.html could not be completed" in shown.err


def test_a_batch_keeps_its_numbers_where_a_finished_run_lost_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("kept", "damaged")
    orders = [Order(name, tmp_path / "drive", "psi", Config(), Inputs("none")) for name in names]
    verdict = {"status": "not judged", "reasons": ["2 scans"]}
    summary = summarise(orders, [RunOutcome({"verdict": verdict, "psi": {"per_point_optimised": float("nan")}})] * 2)
    (tmp_path / "kept").mkdir()
    track = Trajectory(np.arange(5), np.arange(15.0).reshape(5, 3))
    write_tum(tmp_path / "kept" / "trajectory.tum", track)
    write_batch(tmp_path, summary)
    add_warnings(tmp_path / "batch.json", summary, write_batch_page(tmp_path, "runs", summary, "runs: []"))
    written = read_summary(tmp_path, "batch.json")
    assert written["counts"] == {"pass": 0, "warn": 0, "fail": 0, "not judged": 2, "failed": 0, "not finished": 0}
    assert written["runs"][0]["psi_per_point"] is None
    (warning,) = written["warnings"]
    assert warning.startswith("the picture of damaged could not be completed (")
    page = (tmp_path / "report.html").read_text()
    assert page.count('<span class="badge none">not judged</span>') == 2 and page.count("data:image/png") == 1
    for status, count in (("pass", 0), ("warn", 0), ("fail", 0), ("not judged", 2)):
        assert f'<th scope="row">{status}</th><td>{count}</td>' in page
    monkeypatch.setattr("mqslam.report.page._environment", failing(ValueError("by nothing")))
    add_warnings(tmp_path / "batch.json", summary, write_batch_page(tmp_path, "runs", summary, "runs: []"))
    said = "report.html could not be completed (ValueError: by nothing); the other results are complete"
    assert read_summary(tmp_path, "batch.json")["warnings"][-1] == said
