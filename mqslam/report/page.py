"""Makes the HTML page of a command from sections and one template: a single file that loads nothing from elsewhere."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mqslam.auditing.table import TESTS, MapTest
from mqslam.auditing.verdict import GRAVEST_FIRST, VerdictStatus
from mqslam.core.wording import count_of, list_reasons
from mqslam.errors import tolerate
from mqslam.execution.extras import list_versions
from mqslam.execution.files import write_text
from mqslam.execution.guards.memory import return_free_memory
from mqslam.report.canvas import is_svg
from mqslam.report.words import ABSENT, format_p_value, format_value, part_of
from mqslam.results.files import read_origin

_PARTLY: Final = "No test shows evidence of a fault of this map; what could not be judged is listed below."
_MEANINGS: Final = {
    "pass": "No test shows evidence of a fault of this map, and the tests would have shown a bad one.",
    "warn": "Something is wrong with this map or the run; the reasons say what, and the map shows where.",
    "fail": "Do not trust this map; the reasons say what is wrong, and the map shows where.",
    "not judged": "There is too little evidence to say whether this map is good.",
}
_OPTION: Final = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_TEST_HEAD: Final = ("test", "verdict", "p-value", "what it found", "what it cannot see")


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture with a heading and an optional caption.

    Args:
        picture: content of a PNG file, or an SVG element.
        heading: heading of the picture.
        caption: line about the picture; empty for no caption.
        description: text for readers who do not see the picture; if empty, the heading is this text.
        link: address that a click on the picture opens; None for no link.
    """

    picture: bytes
    heading: str
    caption: str = ""
    description: str = ""
    link: str | None = None


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table that has a link or is marked as the best of its column."""

    text: str
    link: str | None = None
    best: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a page, with a heading for each column.

    Args:
        head: headings of the columns.
        rows: cells of each row. The first cell names the row; the last cell of a short row spans the remaining columns. A
            cell that is a `VerdictStatus` is shown in the colour of the verdict.
        holds_words: whether the cells hold sentences, which are then left-aligned and wrap.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    holds_words: bool = False


@dataclass(frozen=True, slots=True)
class Card:
    """Small pictures under a heading, with an optional line about the pictures."""

    heading: str
    text: str = ""
    figures: Sequence[Figure] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page: notes, pictures, a table, numbers and cards under one heading.

    Args:
        heading: heading of the section; empty for no heading.
        notes: lines for the reader; the first line stands below the heading, a click unfolds the others.
        figures: pictures side by side.
        stacked: pictures one below the other, to the right of `figures`.
        table: a table, which stands next to the figure if there is exactly one figure; None for no table.
        numbers: groups of values: the heading of each group, and name and text of each value. All groups form one table.
        cards: cards side by side.
        folded: a section that a click unfolds; None for none.
    """

    heading: str
    notes: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    stacked: Sequence[Figure] = ()
    table: Table | None = None
    numbers: Sequence[tuple[str, Sequence[tuple[str, str]]]] = ()
    cards: Sequence[Card] = ()
    folded: Section | None = None


@dataclass(frozen=True, slots=True)
class Explorer:
    """An interactive map, with curves over time and close views of the place that was clicked.

    Args:
        notes: lines for the reader; the first line stands below the heading, a click unfolds the others.
        has_charts: whether there are curves over time.
        colours: title of each kind of values that can colour the points, by the name of the values.
        data: data for the page's script, as JSON that is safe inside HTML.
        still: parts with pictures, which the page shows where the script cannot run.
    """

    notes: Sequence[str]
    has_charts: bool
    colours: Mapping[str, str]
    data: Markup
    still: Sequence[Part] = ()


Part: TypeAlias = Section | Explorer | str  # a text says why a part is missing
_Content = TypeVar("_Content", Section, Explorer)


class Page:
    """A page of a report, to which parts are added before it is written.

    Args:
        title: heading of the page.
        summary: content of the JSON file of the result, which holds the verdict, the warnings and the version.
        settings: every setting used, or the plan of a batch, as text.
        facts: names and values of facts about the recording and the trajectory, which stand below the heading.
        notes: lines for the reader on how the recording was interpreted.
        conclusion: the main result of the page, in sentences; empty for none.
    """

    def __init__(
        self,
        title: str,
        summary: Mapping[str, Any],
        settings: str,
        *,
        facts: Sequence[tuple[str, str]] = (),
        notes: Sequence[str] = (),
        conclusion: str = "",
    ) -> None:
        self.title = title
        self.settings = settings
        self.facts = list(facts)
        self.notes = tuple(notes)
        self.conclusion = conclusion
        self.warnings = [str(line) for line in summary.get("warnings") or ()]
        self.lead: list[Part] = []
        self.parts: list[Part] = []
        self.failures: list[str] = []
        self.footer = " · ".join([f"mqslam {summary.get('mqslam_version', ABSENT)}", *list_versions()])
        verdict = part_of(summary, "verdict")
        self.verdict = str(verdict.get("status", ""))
        self.unjudged = [str(line) for line in summary.get("not_judged") or ()]
        self.diagnosis = str(verdict.get("diagnosis", ""))
        self.reasons = list_reasons(verdict)

    @property
    def meaning(self) -> str:
        """What the verdict means for the reader, in a sentence; empty without a verdict."""
        return _PARTLY if self.verdict == VerdictStatus.PASS and self.unjudged else _MEANINGS.get(self.verdict, "")

    def add(self, name: str, make: Callable[[], Section | None]) -> None:
        """Adds a part. If the part cannot be made, the page shows a message in its place and among the warnings.

        Args:
            name: name of the part in this message.
            make: returns the part; None if there is nothing to show.
        """
        self.parts += self._make(name, make)

    def add_lead(self, name: str, make: Callable[[], Section | None]) -> None:
        """Adds a part next to the verdict; the arguments are the same as for `add`."""
        self.lead += self._make(name, make)

    def add_explorer(
        self, make: Callable[[], Explorer | None], still: Sequence[tuple[str, Callable[[], Section | None]]]
    ) -> None:
        """Adds an interactive map, and parts that the page shows where the map cannot run or could not be made.

        Args:
            make: returns the map; None if there is nothing to show.
            still: for each of these parts its name, and the function that returns the part or None.
        """
        pictures = [part for one in still for part in self._make(*one)]
        live = self._make("the map to move in", make)
        whole = [replace(part, still=pictures) for part in live if isinstance(part, Explorer)]
        self.parts += whole or [*live, *pictures]

    def _make(self, name: str, make: Callable[[], _Content | None]) -> list[Part]:
        made: list[Part] = []
        failures: list[str] = []
        with tolerate(name, failures):
            content = make()
            made = [] if content is None else [content]
        return_free_memory()
        self.failures += failures
        return [*made, *failures]

    def write(self, folder: Path) -> list[str]:
        """Writes the page as report.html into an existing folder, with the date and the command from the folder's run.log.

        Returns:
            A message with the reason for each part that could not be made, and for the page if it could not be made itself.

        Raises:
            OutputError: the file cannot be written.
        """
        self.warnings += self.failures
        with tolerate("report.html", self.failures):
            self.facts += read_origin(folder)
            page = _environment().get_template("page.html").render(page=self).strip()  # the macros leave empty lines
            write_text(folder / "report.html", page + "\n")
        return self.failures


def tabulate_tests(summary: Mapping[str, Any], own: Sequence[MapTest] = ()) -> Section | None:
    """Returns a table of the tests of a map: what each test found and what it cannot see. None if no test was made.

    Args:
        summary: content of audit.json or of a run's summary.json.
        own: tests that the user added.
    """
    found = part_of(summary, "tests")
    calm: list[tuple[str, ...]] = []
    others: list[tuple[str, ...]] = []
    for known in (*TESTS, *own):
        if (test := found.get(known.name)) is not None:
            status = VerdictStatus(test["status"])
            label = f"{known.name}: {known.compares}"
            row = (label, status, format_p_value(test.get("p_value")), "; ".join(test["reasons"]), known.blind)
            (calm if status is VerdictStatus.PASS else others).append(row)
    if not calm and not others:
        return None
    others.sort(key=lambda row: GRAVEST_FIRST.index(VerdictStatus(row[1])))
    notes = [
        "What each test compares, what it found, and what it cannot see.",
        "The p-value is the probability that a test finds an error as large anywhere in a map without a fault, if the "
        "stated covariances are right. A small p-value alone is no fault: the error must also exceed the tolerance.",
    ]
    if alarms := part_of(summary, "false_alarms"):
        least, share = format_p_value(alarms["p_value_below"]), format_value(100.0 * alarms["rate"])
        notes.append(
            f"Errors with a p-value of {least} or more count as chance. Chance alone should therefore make the tests call "
            f"no more than {share} % of the good maps bad."
        )
    passed = Section(f"{count_of(len(calm), 'test')} passed", table=Table(_TEST_HEAD, calm, holds_words=True))
    table = Table(_TEST_HEAD, others, holds_words=True) if others else None
    return Section("Tests", notes, table=table, folded=passed if calm else None)


@cache
def _environment() -> Environment:
    """Returns jinja2's environment for the templates, with the filters, tests and functions that the templates use."""
    loader = PackageLoader("mqslam.report")
    made = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters["data_uri"] = lambda png: Markup(f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}")
    made.filters["keep_options"] = lambda text: Markup(_OPTION.sub(r'<span class="option">\g<0></span>', str(escape(text))))
    made.filters["inline"] = lambda svg: Markup(svg.decode("utf-8"))
    made.tests["drawn"] = is_svg
    made.tests["verdict"] = lambda value: isinstance(value, VerdictStatus)
    made.tests["explorer"] = lambda part: isinstance(part, Explorer)
    made.globals["source_of"] = _source_of
    return made


@cache
def _source_of(name: str) -> Markup:
    """Returns the text of a style sheet or script by its file name; a template inserts the text without escaping."""
    return Markup(resources.files("mqslam.report").joinpath("templates", name).read_text(encoding="utf-8"))
