"""The tests of a map side by side, as the pages of runs and audits show them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from mqslam.report.content import Row, Section, Table
from mqslam.report.page import section_of

_TESTS: Final = {
    "trajectory": ("trajectory: its poses as they were given", "errors that are as smooth as a drive"),
    "speeds": ("speeds: successive scans searched for each other", "errors that windows are wide enough to measure"),
    "windows": ("windows: a few scans against their best map", "jumps, and errors that grow slowly"),
    "steps": ("steps: scans against those just before", "errors that grow slowly"),
    "pooled": ("pooled corrections: all of the drive together", "errors that come and go; one scale for everything"),
    "revisits": ("revisits: two passes of one place", "anything where no place is passed twice"),
}


def tabulate_tests(summary: Mapping[str, Any]) -> Section | None:
    """Returns what each test of a map found, and what it cannot see; None where none was made.

    Args:
        summary: content of audit.json or of summary.json.
    """
    found = section_of(summary, "tests")
    rows = tuple(
        Row(label, (found[name]["status"], "; ".join(found[name]["reasons"]), blind))
        for name, (label, blind) in _TESTS.items()
        if name in found
    )
    head = ("test", "verdict", "what it found", "what it cannot see")
    return Section("Tests", (), table=Table(head, rows)) if rows else None
