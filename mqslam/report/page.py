"""How pages are put together: each becomes one HTML file that fetches nothing from anywhere."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.wording import count_of, list_judged
from mqslam.errors import tolerate
from mqslam.execution.extras import list_versions
from mqslam.execution.files import write_text
from mqslam.execution.guards.memory import return_free_memory
from mqslam.report.content import Content, Fold, Frame, PagePart, PageVerdict, Section, Table, TableRow, Values
from mqslam.report.figures.svg import is_svg
from mqslam.report.formatting import ABSENT, format_p_value, format_value

_UNITS: Final = {  # by the endings of names, the longer ones first
    "per_m": " per m",
    "m": " m",
    "s": " s",
    "mb": " MB",
    "percent": " %",
}
_PARTLY: Final = "No test shows evidence of a fault of this map; what could not be judged stands below."
_MEANINGS: Final = {
    "pass": "No test shows evidence of a fault of this map, and the tests would have shown a bad one.",
    "warn": "Something is wrong with this map or the run; the reasons say what, and the map shows where.",
    "fail": "Do not trust this map; the reasons say what is wrong, and the map shows where.",
    "not judged": "There is too little evidence to say whether this map is good.",
}
_RADIANS_PER_M: Final = {"yaw_per_m": "yaw", "yaw_per_m_sigma": "yaw, sigma"}  # shown in degrees per metre
_TESTS: Final = {  # the tests of a map, and what they cannot see
    "trajectory": ("trajectory: its poses as they were given", "errors that are as smooth as a drive"),
    "speeds": ("speeds: successive scans searched for each other", "errors that windows are wide enough to measure"),
    "windows": ("windows: a few scans against their best map", "jumps, and errors that grow slowly"),
    "steps": ("steps: scans against those just before", "errors that grow slowly"),
    "spans": ("spans: scans some 30 m of path apart", "errors that grow more slowly than that shows"),
    "sums": ("sums: spans added up over 60 to 240 m", "bends of less than 0.5 degrees and 0.5 m"),
    "pooled": ("pooled corrections: all of the drive together", "errors that come and go; one scale for everything"),
    "shaking": ("shaking: scans under smoothed poses", "errors that are as smooth as a drive"),
    "revisits": ("revisits: two passes of one place", "anything where no place is passed twice"),
}

_TEST_HEAD: Final = ("test", "verdict", "p-value", "what it found", "what it cannot see")


def collect(name: str, make: Callable[[], Content | None], failures: list[str]) -> PagePart[Content]:
    """Collects a part of a page; where that fails, the part says so and the other parts stand.

    Args:
        name: what the part is called.
        make: makes its content; None where there is nothing to show.
        failures: list to which a failure is added.
    """
    content: Content | None = None
    tried: list[str] = []
    with tolerate(name, tried):
        content = make()
    return_free_memory()
    failures += tried
    return PagePart(content, *tried)


def write_page(path: Path, template: str, frame: Frame, parts: object) -> None:
    """Writes a page.

    Args:
        path: the file.
        template: name of the page's template.
        frame: what surrounds the parts.
        parts: a dataclass of all parts, as the template names them.

    Raises:
        OutputError: the file cannot be written.
    """
    footer = _describe_versions(frame.version)
    write_text(path, _environment().get_template(template).render(frame=frame, parts=parts, footer=footer) + "\n")


def name_values(heading: str, values: Mapping[str, Any]) -> Values:
    """Returns a part of a summary under its own names, whose endings tell the units; nested parts are left out."""
    rows = []
    for key, value in values.items():
        if isinstance(value, Mapping | list | tuple):
            continue
        if key in _RADIANS_PER_M and isinstance(value, float):
            rows.append((_RADIANS_PER_M[key], format_value(math.degrees(value), " °/m")))
            continue
        ending = next((ending for ending in _UNITS if key.endswith(f"_{ending}")), "")
        name, unit = (key.removesuffix(f"_{ending}"), _UNITS[ending]) if ending else (key, "")
        rows.append((name.replace("_", " "), format_value(value, unit)))
    return Values(heading, tuple(rows))


def section_of(summary: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Returns a part of a summary; an empty one where it is absent or None."""
    value = summary.get(key)
    return value if isinstance(value, Mapping) else {}


def verdict_in(summary: Mapping[str, Any]) -> PageVerdict:
    """Returns the verdict that a summary holds, or the verdict that there is none."""
    verdict = section_of(summary, "verdict")
    given = verdict.get("reasons"), summary.get("not_judged")
    reasons, unjudged = ([str(line) for line in lines or ()] for lines in given)
    status = str(verdict.get("status") or "no verdict")
    meaning = _PARTLY if status == VerdictStatus.PASS and unjudged else _MEANINGS.get(status, "")
    return PageVerdict(status, tuple(list_judged(reasons, unjudged)), tuple(unjudged), meaning)


def version_in(summary: Mapping[str, Any]) -> str:
    """Returns the version of mqslam that wrote a summary."""
    return str(summary.get("mqslam_version", ABSENT))


@cache
def _environment() -> Environment:
    """Returns the templates, with what they need to put files and data into a page."""
    environment = Environment(
        loader=PackageLoader("mqslam.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.filters["inline"] = _inline
    environment.tests["drawn"] = is_svg
    environment.tests["verdict"] = lambda value: isinstance(value, VerdictStatus)
    environment.globals |= {"source_of": _source_of}
    return environment


def tabulate_tests(summary: Mapping[str, Any]) -> Section | None:
    """Returns what each test of a map found, and what it cannot see; None where none was made.

    Args:
        summary: content of audit.json or of summary.json.
    """
    found = section_of(summary, "tests")
    rows = tuple(
        TableRow(label, (test["status"], format_p_value(test.get("p_value")), "; ".join(test["reasons"]), blind))
        for name, (label, blind) in _TESTS.items()
        if (test := found.get(name)) is not None
    )
    calm = tuple(row for row in rows if row.values[0] == VerdictStatus.PASS)
    others = tuple(row for row in rows if row not in calm)
    notes = [
        "What each test of the map found, and what it cannot see. Findings about the run stand with the verdict only.",
        "The p-value is the probability that a test shows as much anywhere in a map without a fault, as far as the stated "
        "covariances are right. A small one alone is no fault: what is off must matter, too.",
    ]
    if alarms := section_of(summary, "false_alarms"):
        notes.append(
            f"Steps, spans, pooled corrections, shaking and revisits take as chance what has a p-value of "
            f"{format_p_value(alarms['p_value_below'])} or more, so that chance alone should make them call no more than "
            f"{format_value(100.0 * alarms['rate'])} % of the good maps bad."
        )
    if not rows:
        return None
    table, folded = (Table(_TEST_HEAD, some, holds_words=True) if some else None for some in (others, calm))
    fold = None if folded is None else Fold(f"{count_of(len(calm), 'test')} passed", folded)
    return Section("Tests", tuple(notes), table=table, folded=fold)


def _inline(svg: bytes) -> Markup:
    """Returns a drawing as it stands in a page, where its words can be searched and copied."""
    return Markup(svg.decode("utf-8"))


def _data_uri(png: bytes) -> Markup:
    """Returns a picture as an address that holds the picture itself."""
    return Markup(f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}")


@cache
def _source_of(name: str) -> Markup:
    """Returns a style sheet or script as it is."""
    return Markup(resources.files("mqslam.report").joinpath("templates", name).read_text(encoding="utf-8"))


def _describe_versions(version: str) -> str:
    """Returns the versions of mqslam, Python and the libraries that decide results."""
    return " · ".join([f"mqslam {version}", *list_versions()])
