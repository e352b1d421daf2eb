"""Files of unknown origin: what is no file is not opened, and what a reader lets through is an error about the file."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mqslam.commands.batch import read_plan
from mqslam.config import load_config
from mqslam.errors import ConfigError, DataError, untrusted
from mqslam.formats.maps.nav2_map import read_nav2_map

ERRORS = [
    ArithmeticError("a"),
    AttributeError("a"),
    EOFError(),
    IndexError("a"),
    KeyError("a"),
    MemoryError(),
    np.linalg.LinAlgError("Singular matrix"),
    NotImplementedError(),
    OSError(5, "Input/output error"),
    OverflowError("a"),
    RecursionError("a"),
    SyntaxError("a"),
    TypeError("several\nlines"),
    ValueError("a" * 100_000),
    ZeroDivisionError("a"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_whatever_a_reader_lets_through_is_an_error_about_its_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    @untrusted.reads_file
    def read(path: Path, what: Exception) -> None:
        raise what

    def polar_scans(what: Exception) -> Iterator[int]:
        with untrusted.blame_file(tmp_path / "drive"):
            yield 1
            raise what

    for act in (lambda: read(tmp_path / "drive", error), lambda: list(polar_scans(error))):
        with caplog.at_level(logging.INFO, "mqslam"), pytest.raises(DataError) as raised:
            act()
        assert str(raised.value).startswith(f"{tmp_path / 'drive'}: ") and len(str(raised.value)) < 600
        assert "\n" not in str(raised.value)
    if not isinstance(error, MemoryError | OSError):
        assert caplog.records and all(record.exc_info for record in caplog.records)


@pytest.mark.parametrize("error", [DataError("other", "is broken"), ConfigError("wrong"), KeyboardInterrupt()])
def test_errors_that_say_more_and_interrupts_pass(error: BaseException) -> None:
    with pytest.raises(type(error)) as raised, untrusted.blame_file(Path("drive")):
        raise error
    assert raised.value is error


def test_pipes_sockets_and_devices_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(tmp_path / "socket"))
        for path, kind in (
            (tmp_path / "pipe", "a pipe"),
            (tmp_path / "socket", "a socket"),
            (Path("/dev/zero"), "a device"),
        ):
            for read in (untrusted.check_file, untrusted.open_text, untrusted.read_document):
                with pytest.raises(DataError, match=f"is {kind}, not a file"):
                    read(path)


def test_links_are_refused_where_they_lead_out_of_what_is_read(tmp_path: Path) -> None:
    for name in ("secret", "drive/odom.csv", "drive/gt/truth.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("0")
    out, named, inside = tmp_path / "drive" / "gt" / "out", tmp_path / "named", tmp_path / "drive" / "gt" / "inside"
    out.symlink_to(tmp_path / "secret")
    named.symlink_to(tmp_path / "secret")
    inside.symlink_to(tmp_path / "drive" / "odom.csv")
    assert untrusted.check_file(out) == out
    with untrusted.stay_within(tmp_path / "drive"):
        assert untrusted.check_file(named) == named and untrusted.check_file(inside) == inside
        with pytest.raises(DataError, match="out: is a link out of the recording"):
            untrusted.check_file(out)


@pytest.mark.parametrize(("length", "is_read"), [(1_000_000, True), (1_000_001, False)])
@pytest.mark.parametrize("before", [0, 1, 999_999, 2_500_000])
def test_lines_have_a_length(tmp_path: Path, length: int, is_read: bool, before: int) -> None:
    path = tmp_path / "table.csv"
    path.write_text("x\n" * (before // 2) + "y" * length + "\nz\n")
    if is_read:
        with untrusted.open_text(path) as file:
            assert file.read().endswith("y\nz\n")
    else:
        with pytest.raises(DataError, match="has a line of over 1000000 bytes"):
            untrusted.open_text(path)


@pytest.mark.parametrize("read", [load_config, read_plan, read_nav2_map])
def test_yaml_is_small(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("# " + "x" * 300_000)
    with pytest.raises(DataError, match=r"is larger than 0\.3 MB"):
        read(path)


def test_documents_have_a_size(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("x" * 1001)
    assert len(untrusted.read_document(path)) == 1001
    with pytest.raises(DataError, match=r"is larger than 0\.001 MB"):
        untrusted.read_document(path, 1000)


def test_a_pipe_that_nobody_reads_any_more_is_no_fault_of_the_file() -> None:
    with pytest.raises(BrokenPipeError), untrusted.blame_file(Path("result")):
        raise BrokenPipeError
