"""Result folders: each is checked to be free beforehand, written beside its place and renamed: it is whole or absent."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mqslam.errors import OutputError, Remedy
from mqslam.execution.checkpoint import FOLDER


@contextmanager
def write_folder_aside(out: Path) -> Iterator[Path]:
    """Yields a folder beside `out` that takes the place of `out` when the block ends without an error.

    Its name is always the same, so that the next run clears what a killed run has left there.

    Raises:
        OutputError: the folder cannot be written.
    """
    aside, replaced = out.parent / f".{out.name}.unfinished", out.parent / f".{out.name}.replaced"
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(replaced, ignore_errors=True)
    try:
        aside.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made ({error.strerror})", Remedy.CHOOSE_OUTPUT) from error
    try:
        yield aside
        if out.exists():
            out.rename(replaced)
        aside.rename(out)
        shutil.rmtree(replaced, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror})", Remedy.FREE_SPACE) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def check_free(out: Path, *, force: bool, resume: bool = False, recording: Path | None = None) -> None:
    """Checks that a result folder may be written, before hours are spent on its content.

    Args:
        out: the folder.
        force: whether what it holds may be replaced.
        resume: whether an unfinished run in it is to be continued.
        recording: what the result is computed from, which must not be replaced by it.

    Raises:
        OutputError: the folder exists with content that may be neither replaced nor resumed, holds the recording or lies in
            it, is a file, or cannot be made.
    """
    if out.name in ("", ".."):
        raise OutputError(f"{out}: is not the name of a new folder", Remedy.CHOOSE_OUTPUT)
    unfinished = (out / FOLDER).is_dir()
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not force and not (resume and unfinished)):
        remedy = Remedy.CHOOSE_OR_RESUME_OUTPUT if unfinished else Remedy.CHOOSE_OR_REPLACE_OUTPUT
        raise OutputError(f"{out}: exists already", remedy)
    if recording is not None and recording.resolve().is_relative_to(out.resolve()):
        raise OutputError(f"{out}: holds the recording", Remedy.CHOOSE_OUTPUT)
    if recording is not None and recording.is_dir() and out.resolve().is_relative_to(recording.resolve()):
        raise OutputError(f"{out}: lies in the recording", Remedy.CHOOSE_OUTPUT)
    check_writable(out)


def check_writable(out: Path) -> None:
    """Checks that the nearest existing folder above a new file or folder may be written to.

    Args:
        out: the new file or folder.

    Raises:
        OutputError: that folder may not be written to.
    """
    above = next(folder for folder in out.absolute().parents if folder.exists())
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise OutputError(f"{out}: cannot be made ({above} is not a folder that may be written to)", Remedy.CHOOSE_OUTPUT)


def make_folder(path: Path) -> Path:
    """Makes an output folder and returns it; it must not hold anything yet.

    Raises:
        OutputError: the folder exists with content, is a file, or cannot be made.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise OutputError(f"{path}: exists already", Remedy.CHOOSE_OR_REMOVE_OUTPUT)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be made ({error.strerror})", Remedy.CHOOSE_OUTPUT) from error
    return path
