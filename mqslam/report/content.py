"""What all pages are made of: the page modules collect the content as these types, and the templates alone know HTML."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

Content = TypeVar("Content")


@dataclass(frozen=True, slots=True)
class PagePart(Generic[Content]):
    """A part of a page.

    Args:
        content: what it shows; None where there is nothing to show.
        failure: why it could not be made; empty otherwise.
    """

    content: Content | None
    failure: str = ""


@dataclass(frozen=True, slots=True)
class PageVerdict:
    """The verdict on a map, with its reasons, and apart from these what could not be judged.

    Args:
        status: the verdict.
        reasons: why it is that.
        unjudged: what could not be judged.
        meaning: what it means for the reader, in a sentence.
    """

    status: str
    reasons: tuple[str, ...]
    unjudged: tuple[str, ...] = ()
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Frame:
    """What surrounds the parts of a page.

    Args:
        title: heading of the page.
        settings_yaml: every setting used, or the plan of a batch, as text.
        version: version of mqslam that made the results.
        warnings: what the reader has to know before the numbers.
        notes: what the reader should know about how the recording was understood.
        verdict: the verdict; None on a page that gives none.
        conclusion: sentences that say what the page shows; empty on a page without one.
    """

    title: str
    settings_yaml: str
    version: str
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    verdict: PageVerdict | None = None
    conclusion: str = ""


@dataclass(frozen=True, slots=True)
class Tile:
    """A number to see first, and what it is."""

    value: str
    label: str


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture, as a PNG file or as an SVG element, with its heading and, where needed, a line about it."""

    picture: bytes
    heading: str
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A small picture.

    Args:
        png: the picture as a PNG file.
        caption: the line below it.
        description: text that is read to those who do not see it.
        link: address that a click on it leads to; None without one.
    """

    png: bytes
    caption: str
    description: str
    link: str | None = None


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table.

    Args:
        label: its first cell, which names it.
        values: its other cells; a verdict is shown in its colour.
        link: address that the label leads to; None without one.
        best: numbers, from 0, of the values that are the best of their columns.
    """

    label: str
    values: tuple[str, ...]
    link: str | None = None
    best: frozenset[int] = frozenset()

    @property
    def is_across(self) -> bool:
        """Whether its only value goes across all columns."""
        return len(self.values) > 1 and bool(self.values[0]) and not any(self.values[1:])


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a head; the first column names the rows.

    Args:
        head: what its columns hold.
        rows: its rows.
        holds_words: whether its cells are sentences, which begin at the left and wrap.
    """

    head: tuple[str, ...]
    rows: tuple[TableRow, ...]
    holds_words: bool = False

    def turn(self) -> Table:
        """Returns the same table with rows and columns exchanged."""
        columns = [row.values for row in self.rows]
        rows = (
            TableRow(
                name,
                tuple(values[k] if k < len(values) else "" for values in columns),
                best=frozenset(n for n, row in enumerate(self.rows) if k in row.best),
            )
            for k, name in enumerate(self.head[1:])
        )
        return Table((self.head[0], *(row.label for row in self.rows)), tuple(rows), self.holds_words)


@dataclass(frozen=True, slots=True)
class Fold:
    """A table that unfolds, under a line that says what it holds."""

    line: str
    table: Table


@dataclass(frozen=True, slots=True)
class Section:
    """Pictures or a table under a heading.

    Args:
        heading: the heading.
        notes: what the reader should know; the first line stands below the heading, the others unfold.
        figures: pictures side by side.
        stacked: pictures one below the other, beside the others.
        table: a table; None without one.
        turned: the same table with rows and columns exchanged, which a phone shows instead; None where it shows the table.
        folded: what there is besides, and need not be seen at once; None without it.
    """

    heading: str
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    stacked: tuple[Figure, ...] = ()
    table: Table | None = None
    turned: Table | None = None
    folded: Fold | None = None


@dataclass(frozen=True, slots=True)
class RankedCard:
    """A row of a comparison with its rank.

    Args:
        rank: its rank, 1 for the best; rows that cannot be told apart share one.
        name: its name.
        verdict: the verdict on its map; None where there is none.
        values: what it is ranked by and costs: name, value, and whether it is the best.
    """

    rank: int
    name: str
    verdict: str | None
    values: tuple[tuple[str, str, bool], ...]


@dataclass(frozen=True, slots=True)
class ThumbnailCard:
    """Small pictures of one place under a heading, with a line about them where needed."""

    heading: str
    thumbnails: tuple[Thumbnail, ...]
    text: str = ""


@dataclass(frozen=True, slots=True)
class Gallery:
    """Cards of small pictures under a heading with a line of explanation.

    Args:
        heading: the heading.
        note: the line.
        cards: those to see at once.
        folded: those that unfold, under a line that says what they show.
        line: that line.
    """

    heading: str
    note: str
    cards: tuple[ThumbnailCard, ...]
    folded: tuple[ThumbnailCard, ...] = ()
    line: str = ""


@dataclass(frozen=True, slots=True)
class Values:
    """A card of names and values."""

    heading: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Numbers:
    """The numbers at the end of a page.

    Args:
        heading: heading of the table.
        table: the table that comes first; None without one.
        note: a line of explanation below the table.
        cards: cards of names and values; empty ones are left out.
    """

    heading: str
    table: Table | None
    note: str
    cards: tuple[Values, ...]
