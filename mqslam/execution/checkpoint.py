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
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mqslam
from mqslam.config import Config, VerdictConfig, dump_yaml
from mqslam.core.measurement import Loop, Measurement, Status
from mqslam.core.recording import Recording
from mqslam.core.scans import Detected, PeakCounts, Returns
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ClusterError, DataError, MqslamError, OutputError
from mqslam.execution.files import write_text, written_whole

FOLDER = "checkpoint"
HOW = "continue with --resume"


def run_key(recording: Recording, config: Config, frontend: str, odometry: Trajectory | None) -> str:
    """What a run's result depends on, in one string: another key is another run.

    The verdict's settings are younger than the first checkpoints. At their defaults they are left out, so that a run which
    began before there were any can be resumed.
    """
    digest = hashlib.sha256()
    usual = {"verdict"} if config.verdict == VerdictConfig() else set()
    settings = dump_yaml(config, leave_out=usual)
    path, resolution = str(recording.path.resolve()), str(recording.range_resolution)
    for text in (mqslam.__version__, settings, frontend, path, resolution):
        digest.update(text.encode() + b"\0")
    digest.update(recording.stamps_us.tobytes())
    if odometry is not None:
        digest.update(odometry.stamps_us.tobytes() + odometry.poses.tobytes())
    return digest.hexdigest()


@contextmanager
def unfinished(out: Path, key: str, *, resume: bool, how: str = HOW) -> Iterator[Checkpoint]:
    """The checkpoint of a run while it goes on; what cannot be resumed to any end leaves nothing behind.

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
            raise type(error)(f"{error}; {how}") from error
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
            raise OutputError(
                f"{out}: holds an unfinished run of other data or settings; "
                "choose another --out, or give --force instead of --resume"
            )

    def remove(self) -> None:
        """Delete what was kept, and the result folder if it holds nothing else."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._folder.parent.rmdir()

    @property
    def holds_anything(self) -> bool:
        """Whether there is something to resume."""
        return any(self._folder.glob("*.npz"))

    def detected(self, begin: int, end: int) -> Detected | None:
        """What was detected in the revolutions begin <= k < end, if it was kept."""
        kept = self._load(f"returns-{begin:06d}-{end:06d}.npz", [*_columns(), "ends", "unread", "why", "counts"])
        if kept is None:
            return None
        columns = [np.split(kept[name], kept["ends"][:-1]) for name in _columns()]
        returns = [Returns(*(np.ascontiguousarray(part) for part in parts)) for parts in zip(*columns, strict=True)]
        errors = (DataError(*words) for words in kept["why"].tolist())
        unread = dict(zip(kept["unread"].tolist(), errors, strict=True))
        return Detected(returns, unread, counts=PeakCounts(*kept["counts"].tolist()))

    def keep_detected(self, begin: int, end: int, found: Detected) -> None:
        """Keep what was detected in a stretch of revolutions."""
        arrays = {name: np.concatenate([getattr(r, name) for r in found.returns]) for name in _columns()}
        arrays["ends"] = np.cumsum([len(r) for r in found.returns])
        arrays["counts"] = np.array(astuple(found.counts), dtype=np.int64)
        arrays["unread"] = np.array(list(found.unread), dtype=np.int64)
        why = [(str(error.path), error.problem, error.remedy) for error in found.unread.values()]
        arrays["why"] = np.array(why, dtype=np.str_).reshape(-1, 3)
        self._save(f"returns-{begin:06d}-{end:06d}.npz", arrays)

    def measurements(self) -> tuple[list[Measurement], float] | None:
        """All measurements and the Doppler shift [s] they were made with, if they were kept."""
        kept = self._load("measurements.npz", [*(f.name for f in fields(Measurement)), "doppler_beta"])
        if kept is None:
            return None
        rows = zip(*(kept[f.name] for f in fields(Measurement)), strict=True)
        motions = [
            Measurement(
                float(t0),
                float(t1),
                pose,
                covariance,
                Status(str(status)),
                float(psi),
                float(psi_odometry),
                int(points),
                float(matched),
            )
            for t0, t1, pose, covariance, status, psi, psi_odometry, points, matched in rows
        ]
        return motions, float(kept["doppler_beta"])

    def keep_measurements(self, motions: Sequence[Measurement], doppler_beta: float) -> None:
        """Keep all measurements of a run."""
        arrays: dict[str, NDArray[Any]] = {"doppler_beta": np.array(doppler_beta)}
        for f in fields(Measurement):
            arrays[f.name] = np.array([getattr(m, f.name) for m in motions])
        self._save("measurements.npz", arrays)

    def loops(self) -> tuple[list[Loop], int] | None:
        """The loops in the graph and the number of pairs tried, if they were kept."""
        kept = self._load("loops.npz", [*(f.name for f in fields(Loop)), "tried"])
        if kept is None:
            return None
        rows = zip(*(kept[f.name] for f in fields(Loop)), strict=True)
        loops = [
            Loop(int(a), int(b), pose, covariance, float(share), float(psi)) for a, b, pose, covariance, share, psi in rows
        ]
        return loops, int(kept["tried"])

    def keep_loops(self, loops: Sequence[Loop], tried: int) -> None:
        """Keep the loops that are in the graph."""
        arrays: dict[str, NDArray[Any]] = {"tried": np.array(tried)}
        for f in fields(Loop):
            arrays[f.name] = np.array([getattr(loop, f.name) for loop in loops])
        self._save("loops.npz", arrays)

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
            raise OutputError(f"{self._folder}: cannot be made ({error.strerror}); choose another --out") from error
        if not (self._folder / "run.json").exists():
            write_text(self._folder / "run.json", json.dumps({"key": self._key}))
        with written_whole(self._folder / name) as aside, aside.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


def _columns() -> list[str]:
    return [f.name for f in fields(Returns)]
