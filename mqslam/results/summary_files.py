"""What the result files of all commands share."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mqslam.execution.files import write_json


def format_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> str:
    """Returns rows under the names of their columns; what a row lacks or does not know is an empty cell.

    Args:
        rows: to write.
        columns: their names in order; by default those of the row that has the most, so that without rows there is nothing.
    """
    names = columns or max((list(row) for row in rows), key=len, default=[])
    if not names:
        return ""
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n", restval="")
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
