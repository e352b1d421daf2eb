"""The results of benchmarks as JSON files, and the tables on the pages, which are theirs: no figure is typed.

A page holds `<!-- bench: NAME -->` and `<!-- /bench -->`, and between them the table of NAME.json.
`<!-- bench: NAME KEY=TEXT -->` asks for the rows with that text only, without its column.
`<!-- bench: NAME only=KEY,KEY -->` asks for some columns only.
`<!-- bench: NAME KEY=TEXT bounds=all -->` lists the bounds that other rows miss, too.
`<!-- bench: NAME made -->` asks for the command and the machine that made the table.
`<!-- bench: summary -->` asks for the table of summary.json, whose figures are those of several results.
Figures of these rows that miss a bound of their benchmark are listed under the table.
"""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.benchmark import Benchmark, Cell, Row
from bench.timing import Took

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    ROOT / "README.md",
    ROOT / "BENCHMARKS.md",
    ROOT / "docs" / "tutorials" / "compare.md",
    ROOT / "docs" / "reference" / "seeds.md",
)
BASELINE = Path(__file__).with_name("baseline")
LITERATURE = Path(__file__).with_name("literature.json")
"""Figures that others have published, or that were measured elsewhere."""
SUMMARY = Path(__file__).with_name("summary.json")
"""The rows of the first table of BENCHMARKS.md: where to find a figure of mqslam, and those of its peers."""
_BLOCK = re.compile(r"(<!-- bench: ([^\n]*?) -->\n).*?(<!-- /bench -->)", re.DOTALL)
_DIGITS = 6  # more of a figure would only show noise


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table, of a benchmark or of the literature."""

    name: str  # what pages call it by
    columns: list[dict[str, str]]  # key, head and format of each
    rows: list[dict[str, Any]]  # cells by key; those of a benchmark also say whether the row is `judged`

    def choose(self, where: Mapping[str, str]) -> list[dict[str, Any]]:
        """Returns the rows that have some texts, by the key of their column.

        Raises:
            ValueError: no row has these texts.
        """
        rows = [row for row in self.rows if all(row.get(key) == text for key, text in where.items())]
        if not rows:
            raise ValueError(f"{self.name} has no row with {dict(where)}")
        return rows

    def format(self, where: Mapping[str, str], only: Sequence[str] = ()) -> str:
        """Returns the table in Markdown, which people read in a terminal too.

        Args:
            where: texts that the rows to be shown have, by the key of their column; those columns are left out.
            only: keys of the columns to be shown; all others are shown if there are none.

        Raises:
            ValueError: no row has these texts.
        """
        columns = [c for c in self.columns if c["key"] not in where and (not only or c["key"] in only)]
        rows = self.choose(where)
        cells = [[column["head"] for column in columns]]
        cells += [[_format_cell(row.get(column["key"]), column["form"]) for column in columns] for row in rows]
        widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
        lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in cells]
        lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class Result(Table):
    """The result of a benchmark: its table with all that is needed to make it again."""

    what: str  # as in `Benchmark`
    data: str  # as in `Benchmark`
    seeds: list[int]  # as in `Benchmark`
    version: str  # of mqslam
    machine: dict[str, Any]  # the processor, the number of its cores, and Python's version
    command: str  # which makes the result
    took: dict[str, float]  # how long that took, with the making of recordings that were not there

    @classmethod
    def read(cls, path: Path) -> Result:
        """Reads a result from a JSON file."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))

    def write(self, path: Path) -> None:
        """Writes the result as JSON; a number that is not finite is a ValueError."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")

    def describe_making(self) -> str:
        """Returns a line in Markdown that says how the table was made, and how long that took."""
        machine = f"{self.machine['cores']} cores of {self.machine['processor']}"
        seeds = f", seeds {', '.join(map(str, self.seeds))}" if self.seeds else ""
        return f"`{self.command}` ({self.data} data{seeds}; mqslam {self.version}; {self.describe_time()}, {machine})"

    def describe_time(self) -> str:
        """Returns how long the benchmark took, on the clock and on all cores together."""
        return f"{_format_seconds(self.took['wall_s'])}, {_format_seconds(self.took['processor_s'])} of processor time"


def make_result(name: str, benchmark: Benchmark, rows: list[Row], took: Took) -> Result:
    """Returns the result of a benchmark that has just been run on this machine."""
    from mqslam.version import __version__

    return Result(
        name=name,
        what=benchmark.what,
        data=benchmark.data,
        seeds=list(benchmark.seeds),
        version=__version__,
        machine={"processor": _name_processor(), "cores": os.cpu_count(), "python": platform.python_version()},
        command=f".venv/bin/python tests/bench/run.py {name}",
        took={"wall_s": round(took.wall_s), "processor_s": round(took.processor_s)},
        columns=[{"key": column.key, "head": column.head, "form": column.form} for column in benchmark.columns],
        rows=[{"judged": row.judged, **{key: _shorten(cell) for key, cell in row.cells.items()}} for row in rows],
    )


def fill_page(text: str, results: Path = BASELINE) -> str:
    """Returns the text of a page with every block filled anew.

    Args:
        text: Markdown.
        results: folder of the results, a JSON file each.

    Raises:
        ValueError: a result has no such row.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}\n{_make_block(block[2].split(), results)}\n\n{block[3]}", text)


def list_blocks(text: str) -> list[str]:
    """Lists the names of the results that a page shows."""
    return [block[2].split()[0] for block in _BLOCK.finditer(text)]


def write_pages() -> None:
    """Fills the project's pages from the committed results."""
    for page in PAGES:
        page.write_text(fill_page(page.read_text(encoding="utf-8")), encoding="utf-8")


def _make_block(words: list[str], results: Path) -> str:
    if words[0] == LITERATURE.stem:
        return Table(**json.loads(LITERATURE.read_text(encoding="utf-8"))).format(
            dict(word.split("=", 1) for word in words[1:])
        )
    if words[0] == SUMMARY.stem:
        return _make_summary(results).format({})
    path = results / f"{words[0]}.json"
    if not path.exists():
        return "These figures have not been measured yet."
    result = Result.read(path)
    if words[1:] == ["made"]:
        return result.describe_making()
    where = dict(word.split("=", 1) for word in words[1:])
    only = where.pop("only").split(",") if "only" in where else ()
    bounded = {} if where.pop("bounds", "") == "all" else where
    return "\n\n".join([result.format(where, only), *_list_missed(result, bounded)])


def _make_summary(results: Path) -> Table:
    """Returns a table of the main figures: each of mqslam beside the best one of its peers, and the benchmark it is from."""
    heads = {"data": "data", "what": "what", "ours": "psi", "other": "best peer", "benchmark": "benchmark"}
    rows = []
    for entry in json.loads(SUMMARY.read_text(encoding="utf-8")):
        result = Result.read(results / f"{entry['benchmark']}.json")
        found = [(_find_cell(result, entry, other), other["name"]) for other in entry["others"]]
        best = min(found, default=None)
        ours = entry["form"].format(_find_cell(result, entry, entry["ours"]))
        other = None if best is None else f"{entry['form'].format(best[0])} ({best[1]})"
        rows.append({"data": entry["data"], "what": entry["what"], "ours": ours, "other": other, "benchmark": result.name})
    return Table(
        name=SUMMARY.stem, columns=[{"key": key, "head": head, "form": "{}"} for key, head in heads.items()], rows=rows
    )


def _find_cell(result: Result, entry: Mapping[str, Any], wanted: Mapping[str, Any]) -> float:
    """Returns the figure of the one row that has the wanted texts.

    Raises:
        ValueError: there is no such row, or more than one.
    """
    (row,) = result.choose(wanted["where"])
    return float(row[wanted.get("key", entry["key"])])


def _list_missed(result: Result, where: Mapping[str, str]) -> list[str]:
    """Returns a list in Markdown of the bounds that the chosen rows of a result miss, under a heading, or nothing."""
    from bench.benchmarks import BENCHMARKS  # it needs all of mqslam

    benchmark = BENCHMARKS.get(result.name)
    missed = benchmark.find_missed(result.name, result.choose(where), is_whole=not where) if benchmark else []
    return (
        ["Bounds that were set before measuring and are missed:", "\n".join(f"- {line}." for line in dict.fromkeys(missed))]
        if missed
        else []
    )


def _format_cell(cell: Cell, form: str) -> str:
    if cell is None:
        return "-"
    return cell if isinstance(cell, str) else form.format(cell)


def _format_seconds(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _shorten(cell: Cell) -> Cell:
    return float(f"{cell:.{_DIGITS}g}") if isinstance(cell, float) else cell


def _name_processor() -> str:
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text(encoding="utf-8").splitlines() if cpus.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()
