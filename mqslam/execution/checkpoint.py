"""What a run has computed so far, on disk, so that one that dies can be resumed.

Kept are the returns of every stretch of revolutions, the measurements once all are there, and the loops. A stage that
was cut short is done again from its start; everything is deterministic, so the result is the same to the byte.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import mqslam
from mqslam.config import Config, dump_yaml
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ClusterError, MqslamError, OutputError, Remedy
from mqslam.execution.files import write_text, written_whole
from mqslam.execution.kept import Kept

R = TypeVar("R")

FOLDER = "checkpoint"


def run_key(recording: Recording, config: Config, frontend: str, odometry: Trajectory | None) -> str:
    """Returns what a run's result depends on, in one string: another key is another run."""
    digest = hashlib.sha256()
    path, resolution = str(recording.path.resolve()), str(recording.range_resolution)
    for text in (mqslam.__version__, dump_yaml(config), frontend, path, resolution):
        digest.update(text.encode() + b"\0")
    digest.update(recording.stamps_us.tobytes())
    if odometry is not None:
        digest.update(odometry.stamps_us.tobytes() + odometry.poses.tobytes())
    return digest.hexdigest()


@contextmanager
def unfinished(out: Path, key: str, *, resume: bool, how: str = Remedy.RESUME) -> Iterator[Checkpoint]:
    """Yields the checkpoint of a run while it goes on; what cannot be resumed to any end leaves nothing behind.

    What is left behind by a full disk, a lost cluster, an interrupt or a fault of ours says how to go on.

    Args:
        out: the run's result folder.
        key: what the run's result depends on.
        resume: whether to use what an earlier run has left there.
        how: how to go on.
    """
    checkpoint = Checkpoint(out, key, resume=resume)
    try:
        yield checkpoint
    except (OutputError, ClusterError) as error:
        if checkpoint.holds_anything:
            raise type(error)(error.message, *error.remedies, how) from error
        raise
    except MqslamError:
        if not resume:
            checkpoint.remove()
        raise
    except BaseException as error:
        if checkpoint.holds_anything:
            error.add_note(how)
        raise


class Checkpoint:
    """A folder with the stages of one run.

    Args:
        out: the run's result folder; the checkpoint lies in it while the run goes on.
        key: what the run's result depends on.
        resume: whether to use what is there.

    Raises:
        OutputError: `resume` is given and what is there belongs to another run.
    """

    def __init__(self, out: Path, key: str, *, resume: bool) -> None:
        self._folder = out / FOLDER
        self._key = key
        run = self._folder / "run.json"
        if not (resume and run.exists()):  # written first: without it, nothing has been kept
            shutil.rmtree(self._folder, ignore_errors=True)
            return
        try:
            kept = json.loads(run.read_text(encoding="utf-8"))["key"]
        except (OSError, ValueError, KeyError, TypeError):
            kept = None
        if kept != key:
            problem = f"{out}: holds an unfinished run of other data or settings"
            raise OutputError(problem, Remedy.REPLACE_UNFINISHED_OUTPUT)

    def remove(self) -> None:
        """Delete what was kept, and the result folder if it holds nothing else."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._folder.parent.rmdir()

    @property
    def holds_anything(self) -> bool:
        """Whether there is something to resume."""
        return any(self._folder.glob("*.npz"))

    def find(self, kept: Kept[R]) -> R | None:
        """Returns a result of a kind, if it was kept and its file is whole."""
        arrays = self._load(kept.file, kept.names)
        return None if arrays is None else kept.unpack(arrays)

    def keep(self, kept: Kept[R], result: R) -> None:
        """Keeps a result of a kind.

        Raises:
            OutputError: it cannot be written.
        """
        self._save(kept.file, kept.pack(result))

    def _load(self, name: str, arrays: Sequence[str]) -> dict[str, NDArray[Any]] | None:
        """The arrays of a file by name, if it is there and whole."""
        try:
            with np.load(self._folder / name, allow_pickle=False) as kept:
                return {key: kept[key] for key in arrays}
        except (OSError, EOFError, ValueError, KeyError, NotImplementedError, zipfile.BadZipFile):
            return None

    def _save(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._folder}: cannot be made ({error.strerror})", Remedy.CHOOSE_OUTPUT) from error
        if not (self._folder / "run.json").exists():
            write_text(self._folder / "run.json", json.dumps({"key": self._key}))
        with written_whole(self._folder / name) as aside, aside.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
