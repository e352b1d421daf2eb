"""The page of a merge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mqslam.config import dump_yaml
from mqslam.errors import tolerate
from mqslam.merging.map_merge import Merged
from mqslam.report.content import Figure, Frame, Gallery, PagePart, Section, Table, TableRow, Thumbnail, ThumbnailCard, Tile
from mqslam.report.figures.merge_figures import COLOUR_NAMES, draw_change, draw_links, draw_recordings, split_points
from mqslam.report.formatting import format_matched, format_value
from mqslam.report.page import collect, version_in, write_page

_SHOWN: Final = 12  # changes that have a picture of their own: a matter of the page's length only
_LISTED: Final = 25  # changes that are in the table of the page; changes.csv has all


@dataclass(frozen=True, slots=True)
class MergeParts:
    """The parts of the page, as merge.html shows them."""

    tiles: PagePart[tuple[Tile, ...]]
    map: PagePart[Section]
    changes: PagePart[Section]
    places: PagePart[Gallery]
    recordings: PagePart[Section]
    recognition: PagePart[Section]


def write_merge_page(folder: Path, merged: Merged, summary: Mapping[str, Any]) -> list[str]:
    """Writes the page of a merge into an existing folder, as one HTML file that opens without a network.

    Args:
        folder: the folder.
        merged: the merge.
        summary: content of summary.json.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    parts = MergeParts(
        tiles=collect("the first numbers", lambda: _make_tiles(summary), failures),
        map=collect("the pictures of the map", lambda: _show_map(merged), failures),
        changes=collect("the table of the changes", lambda: _tabulate_changes(summary), failures),
        places=collect("the pictures of the changes", lambda: _show_changes(merged), failures),
        recordings=collect("the table of the recordings", lambda: _tabulate_recordings(summary), failures),
        recognition=collect("the table of the recognition", lambda: _tabulate_recognition(summary), failures),
    )
    frame = Frame(
        title=f"Merge of {len(merged.trajectories)} recordings",
        settings_yaml=dump_yaml(merged.config),
        version=version_in(summary),
        warnings=(*summary["warnings"], *failures),
        conclusion=str(summary["conclusion"]) + ".",
    )
    with tolerate("report.html", failures):
        write_page(folder / "report.html", "merge.html", frame, parts)
    return failures


def _make_tiles(summary: Mapping[str, Any]) -> tuple[Tile, ...]:
    links, psi = summary["links"], summary["psi"]
    return (
        Tile(format_value(links["count"]), "links between recordings"),
        Tile(
            f"{psi['across_before']:.3f} → {psi['across_after']:.3f}", "ψ per point across recordings, laid rigidly → merged"
        ),
        Tile(format_value(links["residual_median"]), "median residual of the links [standard deviations]"),
        Tile(format_matched(psi["matched"]), "of all points matched"),
        Tile(format_value(len(summary["changes"])), "objects that changed"),
    )


def _show_map(merged: Merged) -> Section:
    points = split_points(merged)
    colours = ", ".join(f"{COLOUR_NAMES[n % len(COLOUR_NAMES)]} is recording {n + 1}" for n in range(len(points)))
    figures = (
        Figure(draw_recordings(points, merged.changes), "Map", f"{colours}; red circles are changes"),
        Figure(draw_links(merged), "Trajectories", "a grey line ties two places that are linked"),
    )
    return Section("Map", (), figures)


def _tabulate_changes(summary: Mapping[str, Any]) -> Section:
    changes = summary["changes"]
    note = (
        "An object that several keyframes of one recording show, where the other one shows nothing and looks past the "
        "place, from the same side and from no farther away, at something behind it. It is looked for only where "
        "it is known well enough how the recordings lie to each other, which far from all links it is not."
    )
    notes = [note] if changes else [note, "None was found."]
    if len(changes) > _LISTED:
        notes.append(f"The {_LISTED} largest of {len(changes)} are listed; changes.csv has all of them.")
    rows = tuple(
        TableRow(
            str(n),
            (
                f"recording {change['shown_by']}",
                f"recording {change['missed_by']}",
                f"({change['x']:.1f}, {change['y']:.1f}) m",
                f"{change['size_x']:.1f} m × {change['size_y']:.1f} m",
                format_value(change["seen"]),
                format_value(change["looks"]),
            ),
        )
        for n, change in enumerate(changes[:_LISTED], 1)
    )
    head = ("change", "shown by", "not by", "place", "size", "keyframes that show it", "keyframes that look past it")
    return Section("Changes", tuple(notes), table=Table(head, rows) if rows else None)


def _show_changes(merged: Merged) -> Gallery | None:
    if not merged.changes:
        return None
    points = split_points(merged)
    cards = []
    for n, change in enumerate(merged.changes[:_SHOWN], 1):
        title = f"{n}. shown by recording {change.shown_by + 1} at ({change.place[0]:.1f}, {change.place[1]:.1f}) m"
        thumbnails = tuple(
            Thumbnail(draw_change(points[k], change, k), f"recording {k + 1}", f"{title}, in recording {k + 1}")
            for k in (change.shown_by, change.missed_by)
        )
        cards.append(ThumbnailCard(title, thumbnails))
    return Gallery("The largest changes", "The same square of the map in both recordings.", tuple(cards))


def _tabulate_recordings(summary: Mapping[str, Any]) -> Section:
    rows = tuple(
        TableRow(
            str(n),
            (
                recording["path"],
                format_value(recording["scans"]),
                format_value(recording["length_m"], " m"),
                format_value(recording["duration_s"], " s"),
            ),
        )
        for n, recording in enumerate(summary["recordings"], 1)
    )
    return Section("Recordings", (), table=Table(("recording", "path", "scans", "path driven", "duration"), rows))


def _tabulate_recognition(summary: Mapping[str, Any]) -> Section:
    names = ("compared", "matches", "rows", "agreeing", "rivals", "ambiguous")
    rows = tuple(
        TableRow(f"result {m['later']} in result {m['earlier']}", tuple(format_value(m[name]) for name in names))
        for m in summary["recognition"]
    )
    note = (
        "Submaps of one result are looked up in the other without a guess of where they are. Rows of matches must agree on "
        "how the two lie to each other, and hardly any may agree on another way. An ambiguous submap fits several places "
        "and counts for none."
    )
    head = ("looked up", "compared", "matches", "rows", "agree", "agree on the next best relation", "ambiguous")
    return Section("Recognition", (note,), table=Table(head, rows))
