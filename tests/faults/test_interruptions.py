"""Commands that are interrupted or killed, and runs and workers that fail while others go on."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path
from unittest.mock import Mock

import pytest
from support.clusters import Cluster, at
from support.commands import INSTALLED, list_processes, mqslam
from support.faults import QUICK, assert_refused, cut_short, images, run_quickly
from support.parameters import mostly_slow

from mqslam.cli import main
from mqslam.cli.remedies import name_options
from mqslam.commands import audit
from mqslam.detection import stage
from mqslam.execution.cluster import connect
from mqslam.execution.folders import CHECKPOINT
from mqslam.execution.local_engine import LocalEngine

INTERRUPTS = list(itertools.product(("run", "compare", "audit", "simulate"), (signal.SIGINT, signal.SIGTERM)))


def wait_until_kept(process: subprocess.Popen[str], out: Path) -> None:
    """Waits until a command has kept what a resumed one begins with."""
    while process.poll() is None and not any((out / CHECKPOINT).rglob("*.npz")):
        time.sleep(0.01)


@pytest.mark.parametrize(("command", "number"), mostly_slow(INTERRUPTS, [("run", signal.SIGINT), ("audit", signal.SIGTERM)]))
def test_ctrl_c_or_sigterm(drive: Path, tmp_path: Path, command: str, number: signal.Signals) -> None:
    """To all processes of the terminal, as Ctrl-C is, or to the command alone, as kill does."""
    folder = tmp_path / "results"
    folder.mkdir()
    arguments = {
        "run": ["run", drive, "--out", folder / "out"],
        "compare": ["compare", drive, "--out", folder / "out", "--frontends", "psi"],
        "audit": ["audit", drive, "--trajectory", "ground_truth", "--out", folder / "out"],
        "simulate": ["simulate", folder / "out", "--duration", "120"],
    }[command]
    process = subprocess.Popen(
        [INSTALLED, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # what runs the tests may ignore it
    )
    assert process.stderr is not None
    shown = [process.stderr.readline()]
    while shown[-1] and not re.match("reading and detecting: 30/30|simulating", shown[-1]):
        shown.append(process.stderr.readline())
    if command != "simulate":
        wait_until_kept(process, folder / "out")
    (os.killpg if number is signal.SIGINT else os.kill)(process.pid, number)
    rest = process.stderr.read()
    assert process.wait(timeout=300) == 128 + number, rest
    last = rest.splitlines()[-1]
    assert "Traceback" not in rest
    if command != "simulate":
        assert last == "mqslam: interrupted; continue with --resume"
        assert {path.name for path in (folder / "out").iterdir()} == {CHECKPOINT}
    else:
        assert last == "mqslam: interrupted" and list(folder.iterdir()) == []
    assert list_processes(process.pid) == []


def test_an_audit_that_was_interrupted_goes_on_with_the_returns_it_has(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def judged(out: str, **more: bool) -> str:
        audit.audit(drive, tmp_path / out, trajectory="ground_truth", **more)
        return (tmp_path / out / "audit.csv").read_text()

    whole = judged("whole")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt) as stopped:
        patch.setattr(audit.judge, "audit", Mock(side_effect=KeyboardInterrupt))
        judged("out")
    assert "--resume" in name_options(stopped.value.__notes__[0])
    monkeypatch.setattr(stage, "_detect_span", Mock(side_effect=AssertionError))
    assert judged("out", resume=True) == whole
    assert not (tmp_path / "out" / CHECKPOINT).exists()


def test_a_signal_during_an_import_is_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """This has no row in the README's table. Libraries turn the signal into errors of other kinds."""

    def interrupted_import(**_: object) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1.0)
        except BaseException as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr("mqslam.cli.app", interrupted_import)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 143 and capsys.readouterr().err == "mqslam: interrupted\n"


def test_a_run_that_was_killed(lane: Path, tmp_path: Path) -> None:
    """At every moment in `tests/cli/test_resume.py`."""
    drive = shutil.copytree(lane, tmp_path / "drive")
    assert run_quickly(drive, tmp_path / "whole", "--quiet").code == 0
    quick = tmp_path / "quick.yaml"
    out = tmp_path / "results" / "out"
    out.parent.mkdir()
    process = subprocess.Popen([INSTALLED, "run", drive, "--out", out, "--config", quick, *QUICK, "--quiet"])
    end = time.monotonic() + 600.0
    while process.poll() is None and not list(out.glob(f"{CHECKPOINT}/returns-*.npz")) and time.monotonic() < end:
        time.sleep(0.002)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert_refused(run_quickly(drive, out), "--resume to continue the unfinished run")
    assert run_quickly(drive, out, "--resume", "--quiet").code == 0
    assert (out / "map.ply").read_bytes() == (tmp_path / "whole" / "map.ply").read_bytes()


def test_a_run_of_a_batch_that_fails(drive: Path, tmp_path: Path) -> None:
    for image in images(shutil.copytree(drive, tmp_path / "broken")):
        cut_short(image)
    (tmp_path / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    (tmp_path / "runs.yaml").write_text("runs: [{data: broken}, {data: gone}, {data: drive, config: quick.yaml}]")
    shown = mqslam("batch", tmp_path / "runs.yaml", "--out", tmp_path / "out", "--jobs", "1", "--quiet")
    assert shown.code == 1 and "Traceback" not in shown.err
    first, second = shown.err.splitlines()
    assert first.startswith("broken failed: ") and "is not a readable PNG" in first
    assert second.startswith("gone failed: ") and "does not exist" in second
    names = {"drive", "batch.json", "batch.csv", "report.html"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names


def test_a_worker_process_of_this_machine_that_dies(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def kill_workers() -> None:
        for worker in multiprocessing.active_children():
            worker.kill()

    assert run_quickly(drive, tmp_path / "alone").code == 0
    with monkeypatch.context() as patch:
        left = at(patch, "windows", kill_workers)
        shown = run_quickly(drive, tmp_path / "out", "--jobs", "2")
    assert left and left[0] > 0
    assert_refused(
        shown, "a worker is lost, because its process died", "fewer jobs take less memory; continue with --resume"
    )
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINT}
    assert run_quickly(drive, tmp_path / "out", "--resume").code == 0
    for name in ("trajectory.tum", "map.ply"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes(), name


@pytest.mark.slow
def test_a_worker_of_a_cluster_that_dies(
    drive: Path, tmp_path: Path, crew: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run_quickly(drive, tmp_path / "alone").code == 0
    left = at(monkeypatch, "detect", crew.workers[0].kill)
    shown = run_quickly(drive, tmp_path / "out", "--cluster", crew.address, "--quiet")
    assert (shown.code, shown.err) == (0, "")
    assert left[0] >= 8 and crew.workers[0].wait() == -signal.SIGKILL and crew.workers[1].poll() is None
    for name in ("trajectory.tum", "measurements.csv", "covariances.csv", "map.ply"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes(), name


@pytest.mark.slow
def test_a_cluster_that_is_lost(drive: Path, tmp_path: Path, crew: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_quickly(drive, tmp_path / "alone").code == 0
    with monkeypatch.context() as patch:
        at(patch, "detect", crew.scheduler.kill)
        shown = run_quickly(drive, tmp_path / "out", "--cluster", crew.address)
    assert_refused(shown, f"{crew.address}: the connection to the scheduler is lost; continue with --resume")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINT}
    assert run_quickly(drive, tmp_path / "out", "--resume").code == 0
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (tmp_path / "alone" / "trajectory.tum").read_bytes()


def test_a_terminal_that_is_closed(drive: Path, tmp_path: Path) -> None:
    """It sends SIGHUP, which nohup has a command ignore."""
    out = tmp_path / "out"
    process = subprocess.Popen(
        [INSTALLED, "run", drive, "--out", out],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # what runs the tests may ignore it
    )
    assert process.stderr is not None
    while (line := process.stderr.readline()) and "reading and detecting: 30/30" not in line:
        pass
    wait_until_kept(process, out)
    process.send_signal(signal.SIGHUP)
    last = process.stderr.read().splitlines()[-1]
    assert process.wait(timeout=300) == 129 and last == "mqslam: interrupted; continue with --resume"
    assert {path.name for path in out.iterdir()} == {CHECKPOINT}


def test_a_program_of_another_user_of_this_machine() -> None:
    """No port is open: `tests/execution/test_cluster.py`, `test_no_network_reaches_the_workers_of_this_machine`."""
    with connect("local:1") as engine:
        assert isinstance(engine, LocalEngine)
