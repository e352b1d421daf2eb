"""What the radar of a recording saw, for those who need factors and no whole run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mqslam.commands.inputs.opening import choose_settings, open_data
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all, warn_of_unread
from mqslam.errors import EstimationError, FewReturnsError
from mqslam.execution.runner import Runner
from mqslam.psi.doppler import choose_doppler
from mqslam.psi.place import Beam, beam_of

Source: TypeAlias = Path | str | Recording | Scans
"""A recording: its path, the open recording, or the scans that were detected in it before."""


@dataclass(frozen=True)
class Radar:
    """What the radar of a recording saw, and how it is looked at.

    Args:
        scans: of the recording.
        config: all settings.
        doppler_beta: range shift per closing speed [s], as the settings state it or as psi measured it.
        runner: does the work.
    """

    scans: Scans
    config: Config
    doppler_beta: float
    runner: Runner

    @property
    def beam(self) -> Beam:
        """The sensor model that returns are placed with."""
        return beam_of(self.config.estimator, self.doppler_beta)

    def make_context(self, odometry: Trajectory | None) -> Context:
        """Returns what a front end may know besides the scans."""
        start_us, turn_s, engine = self.scans.start_us, self.scans.revolution_s, self.runner.engine
        return Context(self.config, turn_s, start_us, odometry, doppler_beta=self.doppler_beta, engine=engine)


@contextmanager
def look_at(recording: Source, config: Config | Path | str | None, work: Work) -> Iterator[Radar]:
    """Yields what the radar of a recording saw.

    Args:
        recording: its path, the open recording, or its scans.
        config: settings, or the path of a YAML file, or the name of one that ships with mqslam; None takes the defaults.
        work: where the work is done, and who is told about it.

    Raises:
        ConfigError: the settings hold a mistake.
        DataError: the recording cannot be used.
        EstimationError: the scans hold too few returns, for the block too.
    """
    settings, runner, remedy = choose_settings(config), Runner(work.engine, work.progress), ""
    if isinstance(recording, Path | str):
        recording = open_data(Path(recording), None, None, settings)
    if isinstance(recording, Recording):
        for note in (*recording.notes, *recording.faults):
            work.tell(note)
        recording, detected = detect_all(recording, settings.detector, runner)
        remedy = detected.counts.remedy
        for warning in warn_of_unread(detected.unread):
            work.tell(warning)
    try:
        yield Radar(recording, settings, choose_doppler(recording, settings, runner.engine).beta, runner)
    except FewReturnsError as error:
        raise EstimationError(error.message, *error.remedies, remedy) from error
