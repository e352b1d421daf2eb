"""Writes result folders: each is locked, written under a temporary name and then renamed, so it is complete or absent.

While a command works, no other command writes the folder. Files that other programs put into it meanwhile are kept:
mqslam only ever removes files with names that it writes itself.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from mqslam.errors import DataError, OutputError, Remedy
from mqslam.execution.files import blame_output, flush
from mqslam.execution.guards.locks import Lock, lock_output

CHECKPOINT = "checkpoint"  # name of the folder in an unfinished result folder
UNFINISHED_BATCH = "batch.unfinished"  # name of the file in the folder of a batch until batch.json is written
SUMMARIES = ("summary.json", "audit.json", "compare.json", "batch.json")  # one of them is in the folder of every result
_RESULTS = """
    config.yaml run.log report.html
    trajectory.tum trajectory_*.tum odometry.tum ground_truth.tum mended.tum trajectory_at_truth.tum trajectory.geojson
    measurements.csv covariances.csv poses.csv graph.g2o graph.csv links.csv changes.csv compare.csv batch.csv
    batch.unfinished audit.csv steps.csv spans.csv revisits.csv bad_places.csv bad_places.geojson heatmap.png overlay.png
    map.ply map.pgm map.yaml map.tif map.rrd keyframes/index.json keyframes/*.npy boreas-*.txt
    figure2.pdf figure3.pdf figure2.png figure3.png figure2.svg figure3.svg
"""
_ROWS = "*/trajectory.tum */trajectory.kitti */times.txt */odometry.tum */measurements.csv */covariances.csv"  # of `compare`
_RECORDINGS = """
    radar.timestamps radar/*.png gt/radar_odometry.csv gt/poses_tum.txt odom.csv imu.csv gnss.csv recording.json
    simulation.json applanix/radar_poses.csv calib/*.txt global_pose.csv sensor_data/radar/polar/*.png
    sensor_data/radar/polar_oxford_form/*.png Navtech_Polar.txt Navtech_Polar/*.png metadata.yaml *.db3
"""
_OF_CHECKPOINT = """
    checkpoint/run.json checkpoint/returns-*-*.npz checkpoint/measurements.npz checkpoint/loops.npz
    checkpoint/refinement.npz checkpoint/along.npz checkpoint/.run.json.* checkpoint/.*.npz.*
"""
_NAMES = (*SUMMARIES, *_RESULTS.split(), *_RECORDINGS.split(), *_OF_CHECKPOINT.split())
_UNFINISHED, _REPLACED = "unfinished", "replaced"  # suffixes of temporary folders, and words before their names in a lock


class _Claim(NamedTuple):
    """The claim of this process on a result folder: the folder's lock, and the entries in it that may be replaced."""

    lock: Lock
    replaceable: Sequence[PurePosixPath]


_claims: dict[Path, _Claim] = {}


@contextmanager
def claim_folder(out: Path, *, force: bool = False, resume: bool = False, sources: Sequence[Path] = ()) -> Iterator[None]:
    """Checks that a result folder may be written, and keeps other commands from it until the block ends.

    Args:
        out: the folder.
        force: whether files that mqslam has written into it may be replaced.
        resume: whether an unfinished run in it is to be continued.
        sources: paths of the inputs of the result, which must not lie in the folder or hold it.

    Raises:
        OutputError: the folder has content that must not be replaced or resumed, holds a source or lies in one, is a
            file, cannot be made, or is being written by another command.
    """
    _check_place(out, sources)
    place = out.resolve()
    with lock_output(place) as lock:
        _give_back(place, lock)
        _check_free(out, force=force, resume=resume)
        _claims[place] = _Claim(lock, list_entries(place) if force else ())
        try:
            yield
        finally:
            del _claims[place]


@contextmanager
def write_folder_aside(out: Path) -> Iterator[Path]:
    """Yields a temporary folder beside `out`, which replaces `out` when the block ends without an error.

    Files that mqslam has written into `out` are then removed, and all other files in `out` are moved to the new folder.

    Raises:
        OutputError: the folder cannot be written.
    """
    place = out.resolve()
    if place not in _claims:
        with claim_folder(out, force=True), write_folder_aside(out) as aside:
            yield aside
        return
    claim = _claims[place]
    for left in _list_left(place, claim.lock, _UNFINISHED):
        shutil.rmtree(left, ignore_errors=True)
    aside = _name_beside(place, _UNFINISHED)
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        claim.lock.note(f"{_UNFINISHED} {aside.name}")
        aside.mkdir(parents=True)
    try:
        with blame_output(out, "written", Remedy.FREE_SPACE):
            yield aside
            for root, _, files in os.walk(aside):
                for name in files:
                    flush(Path(root) / name)
                flush(Path(root))
            _put(aside, place, claim)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _put(aside: Path, out: Path, claim: _Claim) -> None:
    """Renames the finished folder `aside` to `out`, and keeps those files of the old `out` that mqslam did not write."""
    if out.exists():
        replaced = _name_beside(out, _REPLACED)
        claim.lock.note(f"{_REPLACED} {replaced.name}")
        out.rename(replaced)
        try:
            aside.rename(out)
        except OSError:
            replaced.rename(out)
            raise
        remove_checkpoint(replaced)
        again = [entry for entry in claim.replaceable if (out / entry).exists()]
        remove_entries(replaced, [*again, *list_written(replaced, claim.replaceable)])
        carry_over(replaced, out)
    else:
        aside.rename(out)
    flush(out.parent)


def _give_back(out: Path, lock: Lock) -> None:
    """Moves the old result folder that a killed command has left beside `out` back to `out`.

    If `out` exists, those files that mqslam did not write are moved there, and its own files are deleted.
    """
    for left in _list_left(out, lock, _REPLACED):
        if not out.exists():
            left.rename(out)
            continue
        remove_entries(left, list_written(left, list_entries(left)))
        carry_over(left, out)


def _list_left(out: Path, lock: Lock, word: str) -> list[Path]:
    """Lists the folders beside `out` that killed commands have left, by the notes `<word> <folder>` in the lock."""
    names = [note.partition(" ")[2] for note in lock.notes if note.startswith(f"{word} .{out.name}.{word}")]
    left = [out.with_name(name) for name in names if "/" not in name]
    return [folder for folder in left if folder.is_dir() and not folder.is_symlink()]


def _name_beside(out: Path, word: str) -> Path:
    """Returns the path `.<name>.<word>` beside a folder, with a number at the end if such a path exists already."""
    path, number = out.with_name(f".{out.name}.{word}"), 0
    while os.path.lexists(path):
        number += 1
        path = out.with_name(f".{out.name}.{word}.{number}")
    return path


def holds_result(folder: Path) -> bool:
    """Returns whether a folder holds the result of a command; newer work may go on in the folder nevertheless."""
    return any((folder / name).is_file() for name in SUMMARIES)


def check_whole(folder: Path) -> None:
    """Checks that a folder is not one of a command that has not ended.

    Raises:
        DataError: the folder is the hidden one in which a command writes its result until it is whole, or it holds
            unfinished work and no result.
    """
    if match := re.fullmatch(rf"\.(.+)\.{_UNFINISHED}(\.\d+)?", folder.resolve().name):
        place = folder.resolve().with_name(match[1])  # becomes the folder of the result
        raise _explain_unfinished(folder, f"holds an incomplete result, which was to become {place.name}", place)
    is_begun = (folder / CHECKPOINT).is_dir() or (folder / UNFINISHED_BATCH).is_file()
    if is_begun and not holds_result(folder):
        raise _explain_unfinished(folder, "holds work that is not finished, and no result yet", folder)


def _explain_unfinished(folder: Path, problem: str, place: Path) -> DataError:
    """Returns the error for a folder with unfinished work, whose result is to become the folder `place`."""
    again = f"repeat its command and {Remedy.RESUME}" if (place / CHECKPOINT).is_dir() else "repeat its command"
    inner = suggest_inner(folder)
    return DataError(folder, problem, f"wait until the work has ended, or {again}{', or ' if inner else ''}{inner}")


def suggest_inner(folder: Path) -> str:
    """Returns advice that names a folder with a result in the given folder; "" if there is none that is not hidden."""
    found = {path.parent.name for name in SUMMARIES for path in folder.glob(f"*/{name}")}
    inner = min((name for name in found if not name.startswith(".")), default=None)
    return "" if inner is None else f"give a folder in it that holds a result, such as {inner}"


def _check_place(out: Path, sources: Sequence[Path]) -> None:
    """Checks that a result folder can be made at the path `out`; it is made from recordings or results at `sources`.

    Raises:
        OutputError: the folder cannot be made there, holds a source, or lies in a source.
    """
    if out.name in ("", ".."):
        raise OutputError(f"{out}: is not the name of a new folder", Remedy.CHOOSE_OUTPUT)
    for source in sources:
        if source.resolve().is_relative_to(out.resolve()):
            raise OutputError(f"{out}: holds the recording", Remedy.CHOOSE_OUTPUT)
        if source.is_dir() and out.resolve().is_relative_to(source.resolve()):
            raise OutputError(f"{out}: lies in the recording", Remedy.CHOOSE_OUTPUT)
    check_writable(out)


def _check_free(out: Path, *, force: bool, resume: bool) -> None:
    """Checks that a result folder holds nothing that must not be replaced.

    Raises:
        OutputError: the folder holds content that must not be replaced, or is a file.
    """
    unfinished = (out / CHECKPOINT).is_dir()
    is_in_use = out.is_dir() and any(out.iterdir()) and not force and not (resume and unfinished)
    if is_in_use or (out.exists() and not out.is_dir()):
        remedy = Remedy.CHOOSE_OR_RESUME_OUTPUT if unfinished else Remedy.CHOOSE_OR_REPLACE_OUTPUT
        is_finished = resume and not unfinished and holds_result(out)
        what = " and holds a finished result, so that there is nothing to resume" if is_finished else ""
        raise OutputError(f"{out}: exists already{what}", remedy)


def check_writable(out: Path) -> None:
    """Checks that the nearest existing folder above a new file or folder may be written to.

    Args:
        out: the new file or folder.

    Raises:
        OutputError: the folder above may not be written to.
    """
    above = next(folder for folder in out.absolute().parents if folder.exists())
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise OutputError(f"{out}: cannot be made ({above} is not a folder that may be written to)", Remedy.CHOOSE_OUTPUT)


def check_new_file(out: Path, *, force: bool) -> None:
    """Checks that a file may be written, before time is spent on its content.

    Args:
        out: the file.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists and may not be replaced, is a folder, or lies in a folder that may not be written to.
    """
    if out.is_dir():
        raise OutputError(f"{out}: exists already and is a folder", Remedy.CHOOSE_OUTPUT)
    if out.exists() and not force:
        raise OutputError(f"{out}: exists already", Remedy.CHOOSE_OR_REPLACE_OUTPUT)
    check_writable(out)


def list_entries(folder: Path) -> list[PurePosixPath]:
    """Lists the paths of files, links and empty folders below a folder, relative to that folder; no link is followed."""
    entries = []
    for root, folders, files in os.walk(folder):
        inside = PurePosixPath(Path(root).relative_to(folder).as_posix())
        links = [name for name in folders if (Path(root) / name).is_symlink()]
        entries += [inside / name for name in (*files, *links)]
        if not folders and not files and Path(root) != folder:
            entries.append(inside)
    return entries


def list_written(folder: Path, entries: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """Returns those entries of a folder whose names mqslam writes; a result of `compare` also has a folder per row."""
    names = (*_NAMES, *_ROWS.split()) if (folder / "compare.json").is_file() else _NAMES
    return [entry for entry in entries if any(_matches(entry, name) for name in names)]


def remove_entries(folder: Path, entries: Iterable[PurePosixPath]) -> None:
    """Removes the given files below a folder, where they exist, and then the folders above them that are left empty."""
    for entry in entries:
        with contextlib.suppress(OSError):
            (folder / entry).unlink()
        for parent in entry.parents[:-1]:
            with contextlib.suppress(OSError):
                (folder / parent).rmdir()


def remove_checkpoint(out: Path) -> None:
    """Removes the checkpoint of an unfinished run from its result folder; files that mqslam did not write stay."""
    inside = [PurePosixPath(CHECKPOINT) / entry for entry in list_entries(out / CHECKPOINT)]
    remove_entries(out, list_written(out, inside))
    with contextlib.suppress(OSError):
        (out / CHECKPOINT).rmdir()


def carry_over(folder: Path, out: Path) -> None:
    """Moves all files below a folder to the same place in another folder; `.kept` is added to names that exist there."""
    for entry in list_entries(folder):
        target = out / entry
        while os.path.lexists(target):
            target = target.with_name(f"{target.name}.kept")
        with contextlib.suppress(OSError):  # a file that cannot be moved stays
            target.parent.mkdir(parents=True, exist_ok=True)
            (folder / entry).rename(target)
        remove_entries(folder, [entry / "moved"])  # removes the folders above the entry that are empty now
    with contextlib.suppress(OSError):
        folder.rmdir()


def _matches(entry: PurePosixPath, name: str) -> bool:
    """Returns whether a path matches the pattern `name`, in which `*` stands for any part of one file's or folder's name."""
    return len(entry.parts) == name.count("/") + 1 and entry.match(name)
