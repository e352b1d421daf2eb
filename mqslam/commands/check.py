"""A check of a recording, from its path to what the checks say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mqslam.check.checks import check_recording
from mqslam.check.finding import Finding, Verdict
from mqslam.commands.opening import choose_odometry, opened
from mqslam.config import Config
from mqslam.execution.progress import Progress, silent
from mqslam.psi.place import beam_of


@dataclass(frozen=True)
class Check:
    """The outcome of a check.

    Args:
        findings: one per check.
        notes: what a user should know about how the recording was understood.
    """

    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def suspicious(self) -> bool:
        """Whether anything contradicts what was assumed."""
        return any(finding.verdict is Verdict.SUSPICIOUS for finding in self.findings)

    @property
    def warning(self) -> str | None:
        """A sentence for the user where most of the checks cannot be told; None where most can."""
        untold = sum(finding.verdict is Verdict.UNTOLD for finding in self.findings)
        if 2 * untold <= len(self.findings):
            return None
        missed = f"{untold} of {len(self.findings)} checks cannot be told, so that most mistakes would go unnoticed here"
        return f"{missed}; odometry and a longer drive with turns would tell more"


def check(
    data: Path,
    settings: Config,
    odometry: str = "auto",
    format: str | None = None,
    range_resolution: float | None = None,
    progress: Progress = silent,
) -> Check:
    """Checks whether a recording contradicts what was assumed to read it.

    Args:
        data: the recording, of which a few short stretches are read.
        settings: all settings.
        odometry: `auto` for the recording's own, `none`, or a file.
        format: name of the recording's layout; None recognises it.
        range_resolution: length of a range bin [m]; None takes the settings', the recording's or its format's.
        progress: called as polar scans are read.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: a recording or an odometry file that cannot be used.
    """
    recording = opened(data, format, range_resolution, settings.sensor)
    track, notes = choose_odometry(recording, odometry)
    findings = check_recording(
        recording,
        track,
        settings.check,
        settings.detector,
        settings.tracker,
        settings.estimator,
        beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0),
        partial(progress, "detect"),
    )
    return Check(tuple(findings), (*recording.notes, *notes))
