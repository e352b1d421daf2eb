"""`mqslam batch`: many runs, one report; what fails is said, what is finished is kept, and a cluster changes no byte."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from support.clusters import cluster
from support.commands import INSTALLED, Result, list_processes, mqslam, read_contents, run_in_this_process

import mqslam as package
from mqslam.commands.batch import read_plan
from mqslam.config import load_config
from mqslam.errors import ConfigError
from mqslam.execution.files import write_json
from mqslam.execution.folders import CHECKPOINT, UNFINISHED_BATCH
from mqslam.results.batch_results import Order, RunOutcome, summarise
from mqslam.simulator import SensorModel, simulate

NAMES = ("wheels", "drive", "radar only")
RUNS = """
runs:
  - {data: drive, name: wheels, frontend: odometry, config: quick.yaml}
  - data: drive
    config: quick.yaml
  - {data: gone, config: quick.yaml}
  - data: drive
    name: radar only
    odometry: none
    config: quick.yaml
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording, a list of runs with one that cannot be, and what they leave; nobody may change it."""
    folder = tmp_path_factory.mktemp("batch")
    drive = folder / "drive"
    simulate(
        drive,
        duration_s=7.0,
        sensor=SensorModel(turn_rate_hz=2.0, azimuths=200, range_resolution=0.35, max_range=60.0),
        movers=0,
    )
    (folder / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    (folder / "runs.yaml").write_text(RUNS)
    with run_in_this_process():
        shown = batch(folder, folder / "out")
    assert shown.code == 1 and shown.out.splitlines()[-1] == f"report: {folder / 'out' / 'report.html'}"
    assert f"gone failed: {drive.with_name('gone')}: does not exist" in shown.err
    lines = shown.err.splitlines()
    assert lines[0] == f"note: gone: {drive.with_name('gone')} does not exist on this machine"
    told = [line[6:].partition(",")[0].partition(": ")[0] for line in lines[1:] if line.startswith("note: ")]
    assert told == [
        *("wheels starts (run 1 of 4)", "wheels is finished", "drive starts (run 2 of 4)", "drive is finished"),
        *("gone starts (run 3 of 4)", "gone failed", "radar only starts (run 4 of 4)", "radar only is finished"),
    ]
    assert re.search(r"(?m)^drive +│ .*│ 1, 2\b", shown.out) and shown.out.count("\nnot judged (1): ") == 1
    return folder


def batch(folder: Path, out: Path, *more: object) -> Result:
    return mqslam("batch", folder / "runs.yaml", "--out", out, "--jobs", "1", *map(str, more))


def tracks(out: Path) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in out.glob("*/trajectory.tum")}


def test_every_run_that_can_be_is_done_and_its_files_are_those_of_a_run(work: Path, tmp_path: Path) -> None:
    assert {path.name for path in (work / "out").iterdir()} == {*NAMES, "batch.json", "batch.csv", "report.html"}
    options = ("--odometry", "none", "--config", work / "quick.yaml", "--jobs", "1", "--quiet")
    assert mqslam("run", work / "drive", "--out", tmp_path / "alone", *options).code == 0
    assert tracks(work / "out")["radar only"] == (tmp_path / "alone" / "trajectory.tum").read_bytes()
    assert set(read_contents(work / "out" / "radar only")) == set(read_contents(tmp_path / "alone"))


def test_the_numbers_of_all_runs_stand_together(work: Path) -> None:
    summary = json.loads((work / "out" / "batch.json").read_text())
    runs = {run["name"]: run for run in summary["runs"]}
    assert next(iter(runs)) == "gone" and set(runs) == {"gone", *NAMES}
    assert summary["counts"]["failed"] == 1 and sum(summary["counts"].values()) == 4 and summary["kept"] == 0
    assert "does not exist" in runs["gone"]["failure"] and runs["gone"]["verdict"] is None
    for name in NAMES:
        alone = json.loads((work / "out" / name / "summary.json").read_text())
        assert runs[name]["verdict"] == alone["verdict"]["status"] and runs[name]["failure"] is None
        assert runs[name]["psi_per_point"] == alone["psi"]["per_point_optimised"]
        assert runs[name]["not_judged"] == "; ".join(alone["not_judged"])
        assert runs[name]["warnings"] == "; ".join(alone["warnings"])
        assert (work / "out" / runs[name]["trajectory"]).is_file() and (work / "out" / runs[name]["report"]).is_file()
    for key, notes in summary["notes"].items():
        for name in NAMES:
            said = json.loads((work / "out" / name / "summary.json").read_text())[key]
            assert sorted(said) == sorted(note["text"] for note in notes if name in note["runs"])
        assert len({note["text"] for note in notes}) == len(notes)
    with (work / "out" / "batch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == list(runs) and rows[0]["psi_per_point"] == ""
    assert float(rows[list(runs).index("drive")]["ate_rmse_m"]) == runs["drive"]["ate_rmse_m"]


def test_show_says_where_the_warnings_of_an_earlier_versions_batch_are(work: Path, tmp_path: Path) -> None:
    summary = json.loads((work / "out" / "batch.json").read_text())
    note = (
        f"note: an earlier version of mqslam wrote this batch; `mqslam show {tmp_path}/NAME` shows the warnings about a run"
    )
    for earlier in (False, True):
        (tmp_path / "batch.json").write_text(json.dumps(summary))
        assert (note in mqslam("show", tmp_path).err) == earlier
        summary.pop("notes", None)


def test_recordings_of_one_name_are_named_after_their_folders_too(tmp_path: Path) -> None:
    data = ("mon/am/drive", "mon/pm/drive", "fri/pm/drive", "fri/other", "drive")
    named = ({"data": path} for path in data)
    (tmp_path / "runs.yaml").write_text(json.dumps({"runs": [*named, {"data": "drive", "name": "again"}]}))
    names = [order.name for order in read_plan(tmp_path / "runs.yaml")[0]]
    assert names == ["am-drive", "mon-pm-drive", "fri-pm-drive", "other", f"{tmp_path.name}-drive", "again"]


def test_the_file_of_a_front_end_lies_beside_the_list(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("class Mine: ...\n")
    (tmp_path / "runs.yaml").write_text("runs: [{data: drive, frontend: mine.py}, {data: other}]")
    orders, _ = read_plan(tmp_path / "runs.yaml")
    assert [order.frontend for order in orders] == [str(tmp_path / "mine.py"), "psi"]
    (tmp_path / "mine.py").unlink()
    with pytest.raises(ConfigError, match=r"run 1: front end .*mine\.py: there is no such file"):
        read_plan(tmp_path / "runs.yaml")


def test_an_entry_may_take_a_part_of_the_recording_and_set_settings(work: Path, tmp_path: Path) -> None:
    part = {"data": str(work / "drive"), "frontend": "odometry", "config": str(work / "quick.yaml"), "start": 1, "end": 4.0}
    (tmp_path / "runs.yaml").write_text(
        json.dumps({"runs": [part | {"set": {"detector.threshold": 35, "map.cell_m": 0.5}}]})
    )
    with run_in_this_process():
        assert batch(tmp_path, tmp_path / "out", "--quiet").code == 0
    (run,) = json.loads((tmp_path / "out" / "batch.json").read_text())["runs"]
    assert (run["revolutions"], run["duration_s"]) == (6, pytest.approx(3.0, abs=0.01))
    assert {"detector.threshold: 35.0", "map.cell_m: 0.5"} <= set(run["settings"].split("; "))
    settings = load_config(tmp_path / "out" / "drive" / "config.yaml")
    assert (settings.detector.threshold, settings.map.cell_m, settings.sensor.doppler_beta) == (35.0, 0.5, 0.0)
    with run_in_this_process():
        shown = batch(tmp_path, tmp_path / "out", "--json", "--fail-on", "fail")
        (run,) = json.loads(shown.out)["runs"]
        assert json.loads(shown.out)["kept"] == 1 and (run["verdict"], shown.code) == ("not judged", 3)


def test_the_frame_of_a_run_is_that_of_its_sensor(work: Path) -> None:
    orders = [Order(name, work / name, "psi", load_config()) for name in ("lidar", "gone")]
    runs = summarise(orders, [RunOutcome({"frame": "lidar"}), RunOutcome(failure="there is none")])["runs"]
    assert {run["name"]: run["frame"] for run in runs} == {"lidar": "lidar", "gone": "radar"}


def test_the_report_shows_every_run_and_leads_to_its_own(work: Path) -> None:
    page = (work / "out" / "report.html").read_text()
    for name in ("wheels/report.html", "drive/report.html", "radar%20only/report.html"):
        assert page.count(f'href="{name}"') == 2, name
    assert page.count("data:image/png") == 3 and "gone failed" in page and "gone/report.html" not in page
    assert not any(fetched in page for fetched in ("http://", "https://", "<script", "<link"))


def test_what_is_finished_is_kept_and_what_failed_is_tried_again(work: Path, tmp_path: Path) -> None:
    for name in ("runs.yaml", "quick.yaml"):
        shutil.copy(work / name, tmp_path)
    out = shutil.copytree(work / "out", tmp_path / "out")
    (tmp_path / "drive").symlink_to(work / "drive")
    (tmp_path / "gone").symlink_to(work / "drive")
    before = {name: (out / name).stat().st_ino for name in NAMES}
    shown = batch(tmp_path, out, "--json")
    assert shown.code == 0 and json.loads(shown.out)["kept"] == 3
    assert [line for line in shown.err.splitlines() if " starts" in line] == ["note: gone starts (run 3 of 4)"]
    assert {name: (out / name).stat().st_ino for name in NAMES} == before
    assert (out / "gone" / "trajectory.tum").read_bytes() == (out / "drive" / "trajectory.tum").read_bytes()


def test_results_of_other_settings_are_neither_kept_nor_replaced_unasked(work: Path, tmp_path: Path) -> None:
    (tmp_path / "drive").symlink_to(work / "drive")
    (tmp_path / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\nmap: {cell_m: 0.5}\n")
    (tmp_path / "runs.yaml").write_text("runs: [{data: drive, name: wheels, frontend: odometry, config: quick.yaml}]")
    out = shutil.copytree(work / "out", tmp_path / "out")
    before = read_contents(out / "wheels")
    with run_in_this_process():
        shown = batch(tmp_path, out, "--quiet")
    assert shown.code == 1 and shown.err.count("\n") == 1
    assert shown.err.startswith(f"wheels failed: {out / 'wheels'}: exists already; ") and "--force" in shown.err
    assert "delete this folder to make this run again" in shown.err
    assert read_contents(out / "wheels") == before
    with run_in_this_process():
        assert batch(tmp_path, out, "--force", "--quiet").code == 0
    assert (out / "wheels" / "config.yaml").read_bytes() != before["config.yaml"]


def test_a_run_that_was_killed_goes_on_where_it_stopped(work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mqslam import slam
    from mqslam.commands import batch as batch_module

    orders, _ = read_plan(work / "runs.yaml")
    terms = batch_module.Terms(tmp_path, 1, False)
    with monkeypatch.context() as patch:
        patch.setattr(slam, "find_loops", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            batch_module.run_one(terms, orders[1])
    assert {path.name for path in (tmp_path / "drive").iterdir()} == {CHECKPOINT}
    monkeypatch.setattr("mqslam.detection.stage.detect_stretch", lambda *_: pytest.fail("detected again"))
    assert batch_module.run_one(terms, orders[1]).failure is None
    assert tracks(tmp_path) == {"drive": tracks(work / "out")["drive"]}


def test_show_tells_which_runs_of_an_interrupted_batch_have_ended(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = shutil.copytree(work / "out", tmp_path / "out")
    (out / "batch.json").rename(tmp_path / "earlier.json")
    shutil.rmtree(out / "drive")
    (tmp_path / "gone").symlink_to(work / "drive")
    for name in ("runs.yaml", "quick.yaml", "drive"):
        (tmp_path / name).symlink_to(work / name)
    (out / "report.html").unlink()

    written: list[Path] = []

    def run_first(_: object, order: Order) -> RunOutcome:
        if order.name == "drive":
            assert written == [out / UNFINISHED_BATCH]  # once, with the runs that are kept
            return RunOutcome(failure="is cursed")
        raise KeyboardInterrupt

    def write(path: Path, tree: object) -> None:
        written.append(path)
        write_json(path, tree)

    monkeypatch.setattr("mqslam.results.batch_results.write_json", write)
    monkeypatch.setattr("mqslam.commands.batch.run_one", run_first)
    with run_in_this_process(), pytest.raises(KeyboardInterrupt):
        package.batch(tmp_path / "runs.yaml", out)
    shown = mqslam("show", out)
    assert shown.code == 0 and "drive failed: is cursed" in shown.err
    lines = [line for line in shown.out.splitlines() if "│" in line and line[0] != " "]
    rows = [[cell.strip() for cell in line.split("│")[:2]] for line in lines]
    assert [row[0] for row in rows] == ["drive", "wheels", "radar only", "gone"]
    verdicts = {run["name"]: run["verdict"] for run in json.loads((tmp_path / "earlier.json").read_text())["runs"]}
    assert [row[1] for row in rows] == ["failed", verdicts["wheels"], verdicts["radar only"], "not finished"]
    assert shown.out.endswith("1 of 4 runs is not finished; the same command as before continues the batch\n")
    assert json.loads(mqslam("show", out, "--json").out)["counts"]["not finished"] == 1
    assert "report: " not in shown.out and mqslam("diff", out, out).code == 2


@pytest.mark.slow
def test_an_interrupted_batch_leaves_no_process_and_says_how_to_go_on(work: Path, tmp_path: Path) -> None:
    words = [INSTALLED, "batch", work / "runs.yaml", "--out", tmp_path / "out", "--jobs", "2"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while not list(tmp_path.glob(f"out/*/{CHECKPOINT}/*.npz")):
        assert process.poll() is None
        time.sleep(0.002)
    process.terminate()
    _, shown = process.communicate(timeout=300)
    assert (
        process.returncode == 143 and shown.splitlines()[-1] == "mqslam: interrupted; the same command continues the batch"
    )
    assert "Traceback" not in shown and list_processes(process.pid) == []
    assert [path.name for path in tmp_path.glob("out/*.*")] == [UNFINISHED_BATCH]


@pytest.mark.slow
def test_runs_on_a_cluster_leave_the_same_trajectories(work: Path, tmp_path: Path) -> None:
    with cluster(tmp_path / "dask") as workers:
        shown = batch(work, tmp_path / "out", "--cluster", workers.address)
    starts = [line for line in shown.err.splitlines() if " starts (run " in line]
    assert shown.code == 1 and "note: gone failed: " in shown.err and len(set(starts)) == 4
    assert tracks(tmp_path / "out") == tracks(work / "out")


def test_a_folder_with_other_results_is_left_alone(work: Path, tmp_path: Path) -> None:
    before = read_contents(work / "out" / "drive")
    shown = batch(work, work / "out" / "drive")
    assert shown.code == 2 and "drive: holds the results of another command; choose another --out" in shown.err
    assert read_contents(work / "out" / "drive") == before
    (tmp_path / "file").write_text("kept")
    assert "cannot be made" in batch(work, tmp_path / "file" / "out").err
