"""What the result files of all commands share."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mqslam.execution.files import write_json


def format_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns rows under the names of the row that has the most; what a row lacks or does not know is an empty cell."""
    if not rows:
        return ""
    text = io.StringIO()
    writer = csv.DictWriter(text, max((list(row) for row in rows), key=len), lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def add_warnings(path: Path, summary: dict[str, Any], warnings: Sequence[str]) -> None:
    """Adds to a summary that is written already what could not be written after it.

    Args:
        path: the summary's JSON file.
        summary: its content, to which the warnings are added.
        warnings: what could not be written, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    if warnings:
        summary["warnings"] += warnings
        write_json(path, summary)
