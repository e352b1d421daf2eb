"""run.log: what made a result, when, by which command, and what was said about it."""

from __future__ import annotations

import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from mqslam.core.wording import list_judged
from mqslam.errors import show
from mqslam.execution.extras import list_versions


def format_log(title: str, lines: Sequence[str]) -> str:
    """Returns the text of run.log.

    Args:
        title: what was done to what.
        lines: what there is to say about it.
    """
    origin = (
        f"finished: {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC",
        f"command: {shlex.join(sys.argv)}",
        f"versions: {', '.join(list_versions())}; {platform.platform()}",
    )
    return "\n".join(map(show, (title, *origin, *lines))) + "\n"


def list_verdict(summary: Mapping[str, Any]) -> list[str]:
    """Returns the lines about the verdict of a summary, and about what could not be judged."""
    verdict, unjudged = summary["verdict"], summary["not_judged"]
    judged = f"verdict: {verdict['status']}: {'; '.join(list_judged(verdict['reasons'], unjudged))}"
    return [judged, *(f"not judged: {line}" for line in unjudged)]


def list_stages(summary: Mapping[str, Any]) -> list[str]:
    """Returns a line per stage: how long it took."""
    return [f"{stage}: {seconds:.2f} s" for stage, seconds in summary["runtime_s"].items()]
