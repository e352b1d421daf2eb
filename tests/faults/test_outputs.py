"""Results that cannot be written: a read-only folder, a full disk, a report that fails, a mistake in the command."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.commands import mqslam, read_contents
from support.faults import QUICK, assert_refused, run_quickly

from mqslam.commands import run as commands_run
from mqslam.execution.folders import CHECKPOINT


def test_an_output_that_is_read_only(drive: Path, tmp_path: Path) -> None:
    before = read_contents(drive)
    for out in (Path("/proc/out"), Path("/sys/out")):
        assert_refused(run_quickly(drive, out), str(out), "cannot be made", "choose another --out")
        assert_refused(mqslam("simulate", out, "--duration", "1", "--quiet"), str(out))
    with mounted(tmp_path / "disk", "8m") as disk:
        (disk / "mine").write_text("kept")
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        assert_refused(run_quickly(drive, disk / "out"), f"{disk}/out: cannot be", "choose another --out")
        assert read_contents(disk) == {"mine": b"kept"}
    assert read_contents(drive) == before


class mounted:
    """A small file system of its own, where the tests may mount one."""

    def __init__(self, place: Path, size: str) -> None:
        self.place, self.size = place, size

    def __enter__(self) -> Path:
        self.place.mkdir()
        options = ["-t", "tmpfs", "-o", f"size={self.size}", "tmpfs", self.place]
        if not shutil.which("mount") or subprocess.run(["mount", *options], capture_output=True).returncode != 0:
            pytest.skip("may not mount a file system here")
        return self.place

    def __exit__(self, *error: object) -> None:
        subprocess.run(["umount", "--lazy", self.place], check=False)


@pytest.mark.parametrize("size_kb", [8, 64, 300, 900])
def test_a_full_disk(drive: Path, tmp_path: Path, size_kb: int) -> None:
    """At several sizes, so that it is full before, in and after the checkpoint."""
    with mounted(tmp_path / "disk", f"{size_kb}k") as disk:
        shown = run_quickly(drive, disk / "out", "--quiet")
        assert_refused(shown, str(disk), "No space left on device", "free space")
        left = read_contents(disk)
        assert all(name == "out" or name.startswith(f"out/{CHECKPOINT}") for name in left), left
        kept = [name for name in left if name.endswith(".npz")]
        assert ("continue with --resume" in shown.err) == bool(kept)
        if kept:
            subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
            assert run_quickly(drive, disk / "out", "--resume", "--quiet").code == 0
            assert CHECKPOINT not in {path.name for path in (disk / "out").iterdir()}
    with mounted(tmp_path / "other", "300k") as disk:
        assert_refused(mqslam("simulate", disk / "sim", "--duration", "3", "--quiet"), "No space left on device")
        assert read_contents(disk) == {}


def test_two_commands_into_one_output(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All moments are in `tests/execution/test_locks.py`."""
    out, shown = tmp_path / "out", []

    def start_others(*_: object) -> None:
        shown.append(mqslam("audit", drive, "--trajectory", "ground_truth", "--out", out, "--quiet"))
        shown.append(mqslam("convert", drive, out, "--to", "boreas", "--quiet"))
        shown.append(mqslam("simulate", out, "--duration", "1", "--quiet"))
        shown.append(mqslam("run", drive, "--out", out, "--force", "--quiet"))

    with at_once(monkeypatch, start_others):
        assert run_quickly(drive, out, "--quiet").code == 0
    for refused in shown:
        assert_refused(refused, f"{out}: ", f"is being written by process {os.getpid()} on ", "; wait until that has ended")
    assert len(shown) == 4 and (out / "trajectory.tum").is_file() and not (out / "audit.json").exists()


@contextlib.contextmanager
def at_once(monkeypatch: pytest.MonkeyPatch, do: Callable[[], None]) -> Iterator[None]:
    """Does something while a run is at its end."""
    write = commands_run.write_run

    def interrupted(*arguments: object) -> None:
        do()
        write(*arguments)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(commands_run, "write_run", interrupted)
        yield


def test_what_a_user_puts_into_the_output(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also beside it, and beside what a killed run has left: `tests/execution/test_locks.py`."""
    out = tmp_path / "out"

    def put() -> None:
        (out / "notes.txt").write_text("mine")
        (out / "trajectory.tum").write_text("mine")

    with at_once(monkeypatch, put):
        assert run_quickly(drive, out, "--quiet").code == 0
    assert (out / "notes.txt").read_text() == (out / "trajectory.tum.kept").read_text() == "mine"
    assert run_quickly(drive, out, "--quiet", "--force").code == 0
    assert (out / "notes.txt").read_text() == (out / "trajectory.tum.kept").read_text() == "mine"
    assert not (out / CHECKPOINT).exists()


def test_a_path_that_is_no_utf_8(drive: Path, tmp_path: Path) -> None:
    named = drive.rename(tmp_path / os.fsdecode(b"drive-\xff"))
    shown = run_quickly(named, tmp_path / os.fsdecode(b"out-\xfe"))
    assert shown.code == 0, shown.err
    assert "drive-\\udcff" in (tmp_path / os.fsdecode(b"out-\xfe") / "run.log").read_text()


def test_a_figure_or_a_report_that_cannot_be_made(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file, stage and page is in `tests/cli/test_optional.py`."""

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("mqslam.report.page._environment", fail)
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0
    assert "warning: report.html could not be completed (MemoryError); the other results are complete" in shown.err
    assert (tmp_path / "out" / "trajectory.tum").is_file() and not (tmp_path / "out" / "report.html").exists()


def test_a_mistake_in_a_command(drive: Path, tmp_path: Path) -> None:
    """All of them are in `tests/cli/test_errors.py`."""
    before = read_contents(tmp_path)
    for words, said in (
        (["--frontend", "kiss_ipc"], "did you mean kiss_icp?"),
        (["--format", "oxfrod"], "did you mean oxford?"),
        (["--odometry", tmp_path / "nothing.csv"], "nothing.csv"),
    ):
        assert_refused(mqslam("run", drive, "--out", tmp_path / "out", "--quiet", *words), said)
    assert read_contents(tmp_path) == before


def test_a_user_without_a_home_and_a_name(drive: Path, tmp_path: Path) -> None:
    """What kernels need is in `tests/execution/test_kernel_cache.py`."""
    quick = tmp_path / "quick.yaml"
    quick.write_text("sensor: {doppler_beta: 0.0}\nloops: {enabled: false}\n")
    words = ["mqslam", "run", str(drive), "--out", str(tmp_path / "out"), "--config", str(quick), *QUICK, "--quiet"]
    program = f"import pwd, sys; pwd.getpwuid = {{}}.__getitem__; sys.argv = {words}; from mqslam.cli import main; main()"
    left = {name: value for name, value in os.environ.items() if name in ("PATH", "PYTHONPATH")}
    shown = subprocess.run([sys.executable, "-c", program], env=left, cwd=tmp_path, capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr
    assert (tmp_path / "out" / "report.html").is_file() and not (tmp_path / "~").exists()
