"""An audit as its page shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.rounds import AuditedTrajectory
from mqslam.auditing.sweeps import Sweeps
from mqslam.config import Config


@dataclass(frozen=True, slots=True)
class AuditReport:
    """An audit as its page shows it.

    Args:
        title: heading of the page.
        summary: content of audit.json; a key that is absent or None is shown as not available.
        sweeps: what was judged.
        audit: the windows and revisits, judged.
        config: all settings.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
        mended: the mended trajectory and its audit; None where nothing was to be mended.
    """

    title: str
    summary: Mapping[str, Any]
    sweeps: Sweeps
    audit: Audit
    config: Config
    warnings: tuple[str, ...]
    settings_yaml: str
    mended: AuditedTrajectory | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader should know that is no warning: that a gyroscope agrees, or shows too little to compare."""
        check = self.summary.get("gyroscope")
        return () if check is None or check["agrees"] is False else (check["statement"],)
