"""A table in Markdown, which people read in a terminal too."""

from __future__ import annotations

from collections.abc import Mapping

from bench.results import Result, Table

NOTHING = "-"  # the cell of a number that is not known


def make_table(table: Table, where: Mapping[str, str]) -> str:
    """Returns a table in Markdown.

    Args:
        table: of a benchmark or of the literature.
        where: texts that the rows to be shown have, by the key of their column; those columns are left out.

    Raises:
        ValueError: no row has these texts.
    """
    columns = [column for column in table.columns if column["key"] not in where]
    rows = [row for row in table.rows if all(row.get(key) == text for key, text in where.items())]
    if not rows:
        raise ValueError(f"{table.name} has no row with {dict(where)}")
    cells = [[column["head"] for column in columns]]
    cells += [[_format(row.get(column["key"]), column["form"]) for column in columns] for row in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def describe_making(result: Result) -> str:
    """Returns a line in Markdown that says how a table was made, and how long that took."""
    machine = f"{result.machine['cores']} cores of {result.machine['processor']}"
    seeds = f", seeds {', '.join(map(str, result.seeds))}" if result.seeds else ""
    return f"`{result.command}` ({result.data} data{seeds}; mqslam {result.version}; {describe_time(result)}, {machine})"


def describe_time(result: Result) -> str:
    """Returns how long a benchmark took, on the clock and on all cores together."""
    return f"{_format_seconds(result.took['wall_s'])}, {_format_seconds(result.took['processor_s'])} of processor time"


def _format_seconds(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _format(cell: str | float | None, form: str) -> str:
    if cell is None:
        return NOTHING
    return cell if isinstance(cell, str) else form.format(cell)
