"""The page of every command: one HTML file that fetches nothing from anywhere, made of sections by one template."""

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

from mqslam.auditing.table import TESTS
from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.wording import count_of, list_reasons
from mqslam.errors import tolerate
from mqslam.execution.extras import list_versions
from mqslam.execution.files import write_text
from mqslam.execution.guards.memory import return_free_memory
from mqslam.report.canvas import is_svg
from mqslam.report.words import ABSENT, format_p_value, format_value, part_of
from mqslam.results.files import read_origin

_PARTLY: Final = "No test shows evidence of a fault of this map; what could not be judged stands below."
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
    """A picture, as a PNG file or as an SVG element, with its heading and, where needed, a line about it.

    Args:
        picture: the picture.
        heading: its heading.
        caption: the line.
        description: text that is read to those who do not see it; the heading where it is empty.
        link: address that a click on it leads to; None without one.
    """

    picture: bytes
    heading: str
    caption: str = ""
    description: str = ""
    link: str | None = None


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table with a link, or one that is the best of its column."""

    text: str
    link: str | None = None
    best: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Args:
        head: what its columns hold.
        rows: cells, of which the first one names the row; the last cell of a short row goes across the columns that are
            left, and a verdict is shown in its colour.
        holds_words: whether its cells are sentences, which begin at the left and wrap.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    holds_words: bool = False


@dataclass(frozen=True, slots=True)
class Card:
    """Small pictures under a heading, with a line about them where needed."""

    heading: str
    text: str = ""
    figures: Sequence[Figure] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page.

    Args:
        heading: the heading; empty without one.
        notes: what the reader should know; the first line stands below the heading, the others unfold.
        figures: pictures side by side.
        stacked: pictures one below the other, beside the others.
        table: a table, beside a picture that stands alone; None without one.
        numbers: groups of names with their values, each under its heading, as one dense table.
        cards: cards side by side.
        folded: what there is besides, and need not be seen at once; None without it.
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
    """A map to move in, with curves over time and the place that was clicked.

    Args:
        notes: what the reader should know about it.
        has_charts: whether there are curves over time.
        colours: what the points can be coloured by: title of each by its name.
        data: what the page's script reads, as JSON that may stand in HTML.
        still: what stands for it where it cannot run.
    """

    notes: Sequence[str]
    has_charts: bool
    colours: Mapping[str, str]
    data: Markup
    still: Sequence[Part] = ()


Part: TypeAlias = Section | Explorer | str  # text says why a part is missing
_Content = TypeVar("_Content", Section, Explorer)


class Page:
    """A page that grows part by part.

    Args:
        title: its heading.
        summary: content of the JSON file of the result, which holds the verdict, the warnings and the version.
        settings: every setting used, or the plan of a batch, as text.
        facts: names and values of what was judged, which stand below the heading.
        notes: what the reader should know about how the recording was understood.
        conclusion: sentences that say what the page shows.
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
        """What the verdict means for the reader."""
        return _PARTLY if self.verdict == VerdictStatus.PASS and self.unjudged else _MEANINGS.get(self.verdict, "")

    def add(self, name: str, make: Callable[[], Section | None]) -> None:
        """Adds a part; where it cannot be made, the page says so in its place and among the warnings.

        Args:
            name: what the part is called.
            make: makes it; None where there is nothing to show.
        """
        self.parts += self._make(name, make)

    def add_lead(self, name: str, make: Callable[[], Section | None]) -> None:
        """Adds what stands beside the verdict; the arguments are those of `add`."""
        self.lead += self._make(name, make)

    def add_explorer(
        self, make: Callable[[], Explorer | None], still: Sequence[tuple[str, Callable[[], Section | None]]]
    ) -> None:
        """Adds a map to move in, and the parts that stand for it where it cannot run: alone where there is no such map.

        Args:
            make: makes the map.
            still: name of each of these parts, and what makes it.
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
        """Writes the page as report.html into an existing folder, whose run.log says when and by which command it was made.

        Returns:
            what could not be made, and why; the page says it too.

        Raises:
            OutputError: the file cannot be written.
        """
        self.warnings += self.failures
        with tolerate("report.html", self.failures):
            self.facts += read_origin(folder)
            page = _environment().get_template("page.html").render(page=self).strip()  # the macros leave empty lines
            write_text(folder / "report.html", page + "\n")
        return self.failures


def tabulate_tests(summary: Mapping[str, Any]) -> Section | None:
    """Returns what each test of a map found, and what it cannot see; None where none was made.

    Args:
        summary: content of audit.json or of a run's summary.json.
    """
    found = part_of(summary, "tests")
    calm: list[tuple[str, ...]] = []
    others: list[tuple[str, ...]] = []
    for known in TESTS:
        if (test := found.get(known.name)) is not None:
            status = VerdictStatus(test["status"])
            label = f"{known.name}: {known.compares}"
            row = (label, status, format_p_value(test.get("p_value")), "; ".join(test["reasons"]), known.blind)
            (calm if status is VerdictStatus.PASS else others).append(row)
    if not calm and not others:
        return None
    notes = [
        "What each test compares, what it found, and what it cannot see.",
        "The p-value is the probability that a test shows as much anywhere in a map without a fault, as far as the stated "
        "covariances are right. A small one alone is no fault: what is off must matter, too.",
    ]
    if alarms := part_of(summary, "false_alarms"):
        least, share = format_p_value(alarms["p_value_below"]), format_value(100.0 * alarms["rate"])
        notes.append(
            f"Tests that give p-values take as chance what has one of {least} or more, so that chance alone should make "
            f"them call no more than {share} % of the good maps bad."
        )
    passed = Section(f"{count_of(len(calm), 'test')} passed", table=Table(_TEST_HEAD, calm, holds_words=True))
    table = Table(_TEST_HEAD, others, holds_words=True) if others else None
    return Section("Tests", notes, table=table, folded=passed if calm else None)


@cache
def _environment() -> Environment:
    """Returns the templates, with what they need to put files and data into a page."""
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
    """Returns a style sheet or script as it is."""
    return Markup(resources.files("mqslam.report").joinpath("templates", name).read_text(encoding="utf-8"))
