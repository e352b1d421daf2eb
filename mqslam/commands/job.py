"""A run from the recording's path to the folder of its results: what `run` does once and `batch` many times."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mqslam.commands.opening import choose_odometry, opened
from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.checkpoint import HOW, run_key, unfinished
from mqslam.execution.engine import Engine
from mqslam.execution.files import plain
from mqslam.execution.folders import whole_folder
from mqslam.execution.progress import Progress
from mqslam.report.run_page import write_run_pages
from mqslam.results.run_results import add_warnings, summarise, write_run
from mqslam.results.run_verdict import list_warnings
from mqslam.slam import Slam, Watch


@dataclass(frozen=True)
class Job:
    """A run that is ready to begin.

    Args:
        recording: the recording.
        odometry: the odometry it uses, or None.
        settings: all settings.
        frontend: name of the front end.
        strict: whether a revolution that cannot be read is an error.
        notes: what a user should know about the choice of odometry.
    """

    recording: Recording
    odometry: Trajectory | None
    settings: Config
    frontend: str
    strict: bool
    notes: tuple[str, ...]

    @property
    def log(self) -> tuple[str, ...]:
        """What a user should know before the run begins."""
        return (*self.recording.notes, *self.notes)

    @property
    def key(self) -> str:
        """What the result depends on."""
        return run_key(self.recording, self.settings, self.frontend, self.odometry)


def job_of(
    data: Path,
    settings: Config,
    frontend: str = "psi",
    odometry: str = "auto",
    format: str | None = None,
    range_resolution: float | None = None,
    *,
    strict: bool = False,
) -> Job:
    """Open a recording and choose its odometry, as the options of `mqslam run` of the same names say.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: a recording or an odometry that cannot be used.
    """
    recording = opened(data, format, range_resolution, settings.sensor, strict=strict)
    track, notes = choose_odometry(recording, odometry)
    return Job(recording, track, settings, frontend, strict, tuple(notes))


def execute(
    job: Job, out: Path, engine: Engine, progress: Progress, *, resume: bool, how: str = HOW, watch: Watch | None = None
) -> dict[str, Any]:
    """Do a run and write its results.

    Args:
        job: the run.
        out: folder of the results.
        engine: where its stages are done.
        progress: called as they go on.
        resume: whether to go on where an unfinished run has stopped.
        how: what an error says about how to go on.
        watch: called with every window once its motion is measured.

    Returns:
        the content of summary.json.

    Raises:
        MqslamError: whatever makes the run impossible; nothing is left then but what can be resumed.
    """
    with unfinished(out, job.key, resume=resume, how=how) as checkpoint:
        slam = Slam(job.settings, job.frontend, engine, progress, checkpoint, strict=job.strict, watch=watch)
        result = slam.run(job.recording, job.odometry)
        warnings = [*list_warnings(result, job.recording), *job.notes]
        summary: dict[str, Any] = plain({**summarise(result, job.recording), "warnings": warnings, "run_key": job.key})
        with whole_folder(out) as folder:
            write_run(folder, result, summary, job.log)
            add_warnings(folder, summary, job.log, write_run_pages(folder, result, job.recording, summary))
    return summary


def finished(out: Path, key: str) -> dict[str, Any] | None:
    """The summary of a run that `out` holds, if it is whole and its result depends on the same."""
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary if isinstance(summary, dict) and summary.get("run_key") == key else None
