"""The tables on the pages, which are those of the committed results: no figure is typed.

A page holds `<!-- bench: NAME -->` and `<!-- /bench -->`, and between them the table of NAME.json.
`<!-- bench: NAME KEY=TEXT -->` asks for the rows with that text only, without its column, and `<!-- bench: NAME made -->`
for the command and the machine that made them.
"""

from __future__ import annotations

import re
from pathlib import Path

from bench.results import read_result, read_table
from bench.tables import describe_making, make_table

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", ROOT / "BENCHMARKS.md", ROOT / "docs" / "tutorials" / "compare.md")
BASELINE = Path(__file__).with_name("baseline")
LITERATURE = Path(__file__).with_name("literature.json")
"""Figures that others have published, or that were measured elsewhere."""
_UNMEASURED = "These figures have not been measured yet."
_BLOCK = re.compile(r"(<!-- bench: ([^\n]*?) -->\n).*?(<!-- /bench -->)", re.DOTALL)


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
        return make_table(read_table(LITERATURE), {})
    path = results / f"{words[0]}.json"
    if not path.exists():
        return _UNMEASURED
    result = read_result(path)
    if words[1:] == ["made"]:
        return describe_making(result)
    return make_table(result, dict(word.split("=", 1) for word in words[1:]))
