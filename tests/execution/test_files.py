"""A result file is whole or absent, whatever happens while it is written."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from mqslam.errors import OutputError
from mqslam.execution.files import write_aside, write_text


def test_the_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    with write_aside(path) as aside:
        assert aside.parent == tmp_path
        aside.write_text("half")
        assert not path.exists()
        aside.write_text("whole")
    assert path.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [path]


def test_who_reads_the_old_file_goes_on_reading_it_whole(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with path.open() as reader:
        write_text(path, "new and longer")
        assert reader.read() == "old"
    assert path.read_text() == "new and longer"


@pytest.mark.parametrize("error", [ValueError("broken"), KeyboardInterrupt()])
def test_an_error_leaves_the_old_content_and_no_temporary_file(tmp_path: Path, error: BaseException) -> None:
    old, new = tmp_path / "old.txt", tmp_path / "new.txt"
    old.write_text("old")
    for path in (old, new):
        with pytest.raises(type(error)), write_aside(path) as aside:
            aside.write_text("half")
            raise error
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(OutputError, match=r"result\.txt: cannot be written \(No space left"), write_aside(path):
        raise OSError(28, "No space left on device")
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/result\.txt: cannot be written"):
        write_text(tmp_path / "nowhere" / "result.txt", "text")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way_is_an_error_and_stays(tmp_path: Path) -> None:
    (tmp_path / "result.txt").mkdir()
    with pytest.raises(OutputError, match=r"result\.txt: cannot be written"):
        write_text(tmp_path / "result.txt", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["result.txt"]


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600), (0o002, 0o664)])
def test_the_users_umask_says_who_may_read_what_is_written(tmp_path: Path, mask: int, mode: int) -> None:
    before = os.umask(mask)
    try:
        write_text(tmp_path / "result.txt", "text")
        assert os.umask(mask) == mask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "result.txt").stat().st_mode) == mode


def test_a_file_is_on_the_disk_before_it_takes_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    flush = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda handle: steps.append(str(Path(f"/proc/self/fd/{handle}").readlink())) or flush(handle)
    )
    monkeypatch.setattr(Path, "replace", lambda self, target: steps.append("named") or self.rename(target))
    write_text(tmp_path / "result.txt", "text")
    file, named, folder = steps
    assert Path(file).name.startswith(".result.txt.") and named == "named" and folder == str(tmp_path)


def test_a_path_that_is_no_utf_8_can_be_written_about(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"drive-\xff")
    write_text(path, f"of {path.name}\n")
    assert path.read_bytes() == b"of drive-\\udcff\n"


def test_text_is_utf_8_and_replaces_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("much longer than what follows")
    write_text(path, "ψ\n")
    assert path.read_bytes() == "ψ\n".encode()
