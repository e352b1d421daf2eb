"""The page of the entries of summary.json and audit.json: none is missing, and none is made up."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from support.commands import mqslam

ROOT = Path(__file__).resolve().parents[2]
FIELDS = runpy.run_path(str(ROOT / "docs" / "hooks" / "fields.py"))


def entries(tree: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Yields the names of all entries of a summary that are no objects."""
    for key, value in tree.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            key, value = f"{key}[]", value[0]
        if isinstance(value, Mapping):
            yield from entries(value, f"{above}{key}.")
        else:
            yield above + key


def undescribed(fields: dict[str, str], file: Path) -> list[str]:
    """Returns the entries of a file that the page does not describe; an empty list of objects shows no entries."""
    empty = ("per_window", "per_revisit", "per_step", "per_span")
    names = (name for name in entries(json.loads(file.read_text())) if name.removeprefix("mended.") not in empty)
    return [name for name in names if FIELDS["find_meaning"](fields, name) is None]


def test_every_entry_of_a_run_is_described(finished: Path) -> None:
    assert undescribed(FIELDS["SUMMARY"], finished / "summary.json") == []


def test_every_entry_of_an_audit_is_described(street: Path, quick: Path, tmp_path: Path) -> None:
    words = ("--trajectory", "odometry", "--config", quick, "--mend", "--quiet")
    assert mqslam("audit", street, "--out", tmp_path / "out", *words).code == 0
    assert undescribed(FIELDS["AUDIT"], tmp_path / "out" / "audit.json") == []
    assert "mended" in json.loads((tmp_path / "out" / "audit.json").read_text())


@pytest.mark.parametrize("name", ["SUMMARY", "AUDIT"])
def test_every_entry_of_the_page_is_written_by_a_module(name: str) -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "mqslam").rglob("*.py"))
    parts = {part.removesuffix("[]") for entry in FIELDS[name] for part in re.split(r"\.", entry) if not part.isupper()}
    bases = {re.sub(r"(?<=\w)_(sigma|p_value)$", "", part) for part in parts}
    assert [part for part in sorted(bases) if not re.search(rf"\b{part}\b", source)] == []


def test_the_page_explains_every_entry_in_words() -> None:
    page = "\n".join(FIELDS["describe_fields"]())
    assert all(f"| `{entry}` | " in page for name in ("SUMMARY", "AUDIT") for entry in FIELDS[name])
    assert all(len(meaning.split()) > 1 for name in ("SUMMARY", "AUDIT") for meaning in FIELDS[name].values())
    assert "| `evaluation.ate_rmse_m` | position error [m], root mean square after the best rigid alignment" in page
