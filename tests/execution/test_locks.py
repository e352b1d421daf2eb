"""One command writes an output at a time, and what it has not written itself is never lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.commands import read_contents

from mqslam.errors import OutputError
from mqslam.execution.folders import CHECKPOINT, claim_folder, list_entries, list_written, write_folder_aside
from mqslam.execution.guards.locks import lock_output

_KILLED = """
import os, signal, sys
from pathlib import Path
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution import folders
out = Path(sys.argv[1])
if sys.argv[2] == "replacing":
    folders.remove_checkpoint = lambda _: os.kill(os.getpid(), signal.SIGKILL)
with claim_folder(out, force=True), write_folder_aside(out) as folder:
    (folder / "summary.json").write_text("new")
    if sys.argv[2] == "writing":
        os.kill(os.getpid(), signal.SIGKILL)
"""


def write(out: Path, *names: str, force: bool = False) -> None:
    with claim_folder(out, force=force), write_folder_aside(out) as folder:
        for name in names:
            (folder / name).write_text("new")


def kill_while(moment: str, out: Path) -> None:
    assert subprocess.run([sys.executable, "-c", _KILLED, out, moment]).returncode == -signal.SIGKILL


def test_a_second_owner_is_refused_and_told_who_the_first_one_is(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with claim_folder(out):
        with (
            pytest.raises(OutputError, match=rf"out: is being written by process {os.getpid()} on .*; wait"),
            claim_folder(out),
        ):
            pass
        with pytest.raises(OutputError, match="is being written"), lock_output(out):
            pass
    with claim_folder(out):
        pass
    assert read_contents(tmp_path) == {}


def test_another_process_is_refused_until_the_owner_dies(tmp_path: Path) -> None:
    waits = (
        "import sys, time\nfrom mqslam.execution.guards.locks import *\nwith lock_output(Path(sys.argv[1])): time.sleep(600)"
    )
    owner = subprocess.Popen([sys.executable, "-c", waits, tmp_path / "out"])
    while not (tmp_path / ".out.lock").exists() or not (tmp_path / ".out.lock").read_text():
        time.sleep(0.05)
    with pytest.raises(OutputError, match=f"process {owner.pid} on"), claim_folder(tmp_path / "out"):
        pass
    owner.kill()
    owner.wait()
    write(tmp_path / "out", "summary.json")
    assert read_contents(tmp_path) == {"out": None, "out/summary.json": b"new"}


def test_a_command_that_fails_leaves_what_a_killed_one_has_left(tmp_path: Path) -> None:
    out = tmp_path / "out"
    kill_while("writing", out)
    before = read_contents(tmp_path)
    with pytest.raises(ValueError, match="no"), claim_folder(out):
        raise ValueError("no")
    assert read_contents(tmp_path) == before and len(before) == 3


def test_a_result_that_appears_between_two_commands_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"

    def finishes(place: Path, lock: object) -> None:
        out.mkdir()
        (out / "summary.json").write_text("of the other")

    monkeypatch.setattr("mqslam.execution.folders._give_back", finishes)
    with pytest.raises(OutputError, match="exists already"):
        write(out, "summary.json")
    assert read_contents(tmp_path) == {"out": None, "out/summary.json": b"of the other"}


@pytest.mark.parametrize("name", [".out.lock", ".out.unfinished/notes.txt", ".out.replaced/notes.txt", ".out.unfinished"])
def test_what_a_user_has_beside_the_output_stays(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("mine")
    if name == ".out.lock":
        with pytest.raises(OutputError, match=r"\.out\.lock: is not a lock of mqslam"):
            write(tmp_path / "out", "summary.json")
    else:
        write(tmp_path / "out", "summary.json")
        write(tmp_path / "out", "summary.json", force=True)
    assert file.read_text() == "mine"


def test_what_a_user_puts_in_while_a_command_works_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with claim_folder(out):
        (out / CHECKPOINT).mkdir(parents=True)
        for name in ("run.json", "loops.npz", "mine.txt"):
            (out / CHECKPOINT / name).write_text("old")
        (out / "sub" / "empty").mkdir(parents=True)
        for name in ("notes.txt", "summary.json", "sub/notes.txt"):
            (out / name).write_text("mine")
        (out / "link").symlink_to("nowhere")
        with write_folder_aside(out) as folder:
            (folder / "summary.json").write_text("new")
    assert (out / "link").is_symlink()
    (out / "link").unlink()
    assert read_contents(tmp_path) == {
        "out": None,
        "out/checkpoint": None,
        "out/checkpoint/mine.txt": b"old",
        "out/notes.txt": b"mine",
        "out/sub": None,
        "out/sub/empty": None,
        "out/sub/notes.txt": b"mine",
        "out/summary.json": b"new",
        "out/summary.json.kept": b"mine",
    }


def test_force_replaces_what_mqslam_has_written_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, "summary.json", "mended.tum", "own name")
    (out / "notes.txt").write_text("mine")
    (out / "sub").mkdir()
    (out / "sub" / "trajectory.tum").write_text("mine")
    write(out, "summary.json", "own name", force=True)
    assert sorted(map(str, list_entries(out))) == ["notes.txt", "own name", "sub/trajectory.tum", "summary.json"]
    assert (out / "notes.txt").read_text() == (out / "sub" / "trajectory.tum").read_text() == "mine"


@pytest.mark.parametrize("moment", ["writing", "replacing"])
def test_what_a_killed_command_leaves_is_cleared_and_what_it_was_to_replace_comes_back(tmp_path: Path, moment: str) -> None:
    out = tmp_path / "out"
    write(out, "summary.json", "mended.tum")
    (out / "notes.txt").write_text("mine")
    kill_while(moment, out)
    assert len(list(tmp_path.iterdir())) == 3  # the result, a folder beside it, and the lock
    write(out, "summary.json", force=True)
    assert read_contents(tmp_path) == {"out": None, "out/notes.txt": b"mine", "out/summary.json": b"new"}


def test_a_link_to_a_folder_is_followed_and_stays(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    write(tmp_path / "out", "summary.json")
    assert (tmp_path / "out").is_symlink() and (tmp_path / "disk" / "summary.json").read_text() == "new"


def test_the_names_of_a_comparisons_rows_are_its_own_only_there(tmp_path: Path) -> None:
    (tmp_path / "psi").mkdir()
    (tmp_path / "psi" / "trajectory.tum").write_text("")
    assert list_written(tmp_path, list_entries(tmp_path)) == []
    (tmp_path / "compare.json").write_text("")
    assert sorted(map(str, list_written(tmp_path, list_entries(tmp_path)))) == ["compare.json", "psi/trajectory.tum"]
