"""The checkpoint of a run: the results so far are kept on disk, so that a run that dies can be resumed.

A checkpoint keeps the returns of every finished group of successive polar scans. It keeps the measured motions, the relative
poses measured between scans near one another along the path, the loops and the refinement, each once it is complete. All
else is computed again. Since all stages are deterministic, a resumed run has the same result to the byte.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config, dump_yaml
from mqslam.core.recording import Recording
from mqslam.core.sensors import NO_SENSORS, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ClusterError, DataError, FrontEndError, MqslamError, OutputError, Remedy, WorkerError, untrusted
from mqslam.execution.files import blame_output, write_aside, write_text
from mqslam.execution.folders import CHECKPOINT, remove_checkpoint
from mqslam.execution.kept import Kept
from mqslam.version import __version__

R = TypeVar("R")


def hash_run(
    recording: Recording, config: Config, frontend: str, odometry: Trajectory | None, sensors: Sensors = NO_SENSORS
) -> str:
    """Returns a hash of a run's inputs, settings and version of mqslam; only a run with this hash resumes its checkpoint.

    The polar scans are not read: the path, the stamps, the length of a range bin and the range offset stand for them.
    """
    digest = hashlib.sha256()
    path, ranges = str(recording.path.resolve()), f"{recording.range_resolution} {recording.range_offset}"
    for text in (__version__, dump_yaml(config), frontend, path, ranges):
        digest.update(text.encode(errors="surrogateescape") + b"\0")
    digest.update(recording.stamps_us.tobytes())
    if odometry is not None:
        digest.update(odometry.stamps_us.tobytes() + odometry.poses.tobytes())
    arrays: dict[str, tuple[NDArray[Any], ...]] = {}
    if sensors.gyroscope is not None:
        arrays["gyroscope"] = (sensors.gyroscope.stamps_us, sensors.gyroscope.rates)
    if (fixes := sensors.fixes) is not None:
        arrays["fixes"] = (fixes.stamps_us, fixes.latitudes, fixes.longitudes, fixes.sigmas_m)
    if sensors.mount is not None:
        arrays["mount"] = (sensors.mount.pose,)
    for name, numbers in arrays.items():
        digest.update(name.encode() + b"".join(array.tobytes() for array in numbers))
    return digest.hexdigest()


@contextmanager
def keep_checkpoint(out: Path, key: str, *, resume: bool, how: str = Remedy.RESUME) -> Iterator[Checkpoint]:
    """Yields the checkpoint of a run, and keeps it after an error if the run can be resumed.

    (1) After a full disk, a lost cluster or worker, a failed front end, lack of memory or an interrupt, the checkpoint
    stays, and the error says how to resume if the checkpoint holds any result. (2) After any other error of mqslam a
    resumed run would fail in the same way, so the checkpoint is removed, unless the run was itself resumed. (3) After an
    unforeseen error the checkpoint stays, but the error does not mention it, since a resumed run would most likely fail in
    the same way.

    Args:
        out: the run's result folder.
        key: hash of the run, by `hash_run`.
        resume: whether to use the checkpoint that an earlier run has left in `out`; otherwise it is removed.
        how: advice on how to resume the run, for the error's message.

    Raises:
        OutputError: `resume` is set, but the checkpoint belongs to a run of other data or settings.
    """
    checkpoint = Checkpoint(out, key, resume=resume)
    try:
        yield checkpoint
    except (OutputError, ClusterError, WorkerError, FrontEndError) as error:
        if checkpoint.holds_anything:
            resumable = type(error)(error.message, *error.remedies, how)
            if not isinstance(error, FrontEndError):  # other code may have turned an interrupt into one of the others
                resumable.add_note(how)
            raise resumable from error
        raise
    except MqslamError:
        if not resume:
            checkpoint.remove()
        raise
    except BaseException as error:
        will_recur = isinstance(error, Exception) and not isinstance(error, MemoryError | OSError)
        if checkpoint.holds_anything and not will_recur:
            error.add_note(how)
        raise


class Checkpoint:
    """A folder with the results of one run's stages.

    Args:
        out: the run's result folder; the checkpoint lies in it while the run goes on.
        key: hash of the run, by `hash_run`.
        resume: whether to use the checkpoint that an earlier run has left in `out`; otherwise it is removed.

    Raises:
        OutputError: `resume` is set, but the checkpoint belongs to a run of other data or settings.
    """

    def __init__(self, out: Path, key: str, *, resume: bool) -> None:
        self._out, self._folder = out, out / CHECKPOINT
        self._key = key
        run = self._folder / "run.json"
        if not (resume and run.exists()):  # run.json is written first: without it, nothing has been kept
            remove_checkpoint(out)
            return
        try:
            kept = json.loads(untrusted.read_document(run))["key"]
        except (DataError, OSError, ValueError, KeyError, TypeError):
            kept = None
        if kept != key:
            problem = f"{out}: holds an unfinished run of other data or settings"
            raise OutputError(problem, Remedy.REPLACE_UNFINISHED_OUTPUT)

    def remove(self) -> None:
        """Deletes the checkpoint, and the result folder if it holds nothing else."""
        remove_checkpoint(self._out)
        with contextlib.suppress(OSError):
            self._out.rmdir()

    @property
    def holds_anything(self) -> bool:
        """Whether the checkpoint holds any result, so that a run can be resumed."""
        return any(self._folder.glob("*.npz"))

    def find(self, kept: Kept[R]) -> R | None:
        """Returns the result of the kind `kept` from the checkpoint; None if its file is missing or damaged."""
        try:
            with (
                untrusted.check_file(self._folder / kept.file).open("rb") as file,
                np.load(file, allow_pickle=False) as found,
            ):
                return kept.unpack(dict(found))
        except (DataError, OSError, EOFError, ValueError, KeyError, NotImplementedError, zipfile.BadZipFile):
            return None

    def keep(self, kept: Kept[R], result: R) -> None:
        """Writes a result of the kind `kept` to the checkpoint.

        Raises:
            OutputError: the file cannot be written.
        """
        with blame_output(self._folder, "made", Remedy.CHOOSE_OUTPUT):
            self._folder.mkdir(parents=True, exist_ok=True)
        if not (self._folder / "run.json").exists():
            write_text(self._folder / "run.json", json.dumps({"key": self._key}))
        with write_aside(self._folder / kept.file) as aside, aside.open("wb") as file:
            np.savez(file, **kept.pack(result))  # type: ignore[arg-type]
