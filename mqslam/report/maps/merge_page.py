"""The page of a merge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.config import dump_yaml
from mqslam.errors import tolerate
from mqslam.merging.changes import Change
from mqslam.merging.merge import Merged
from mqslam.report.content import Figure, Frame, Gallery, PagePart, Section, Table, TableRow, Thumbnail, ThumbnailCard, Tile
from mqslam.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    MAP_SHAPE,
    ORANGE,
    OUTERMOST,
    RED,
    VIOLET,
    View,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_square,
    make_world,
)
from mqslam.report.formatting import format_matched, format_value
from mqslam.report.page import collect, version_in, write_page

# the looks of the figures; no result depends on them
_COLOURS: Final = (BLUE, ORANGE, GREEN, VIOLET)
COLOUR_NAMES: Final = ("blue", "orange", "green", "violet")
_SIDE_M: Final = 40.0  # side of the picture of a change


def split_points(merged: Merged) -> list[NDArray[np.float64]]:
    """Returns the points (N, 2) [m] of each recording in the merged map."""
    keyframes = merged.kept.keyframes
    owner = np.repeat(keyframes.origins, np.diff(keyframes.rows, axis=1)[:, 0])
    return [merged.map.points[owner == n] for n in range(len(keyframes.recordings))]


def draw_recordings(points: Sequence[NDArray[np.float64]], changes: Sequence[Change]) -> bytes:
    """Draws the maps of all recordings over each other, with a circle around every change.

    Args:
        points: (N, 2) of each recording [m].
        changes: between them.
    """
    view = find_common_view(list(points), MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view)
    counts, well_seen = count_points(axes, view, list(points))
    for n, count in enumerate(counts):
        lay_ink(axes, view, count, well_seen, _COLOURS[n % len(_COLOURS)])
    if changes:
        places = np.array([change.place for change in changes])
        axes.plot(places[:, 0], places[:, 1], "o", markerfacecolor="none", markeredgecolor=RED, markersize=5)
    return encode_png(figure)


def draw_links(merged: Merged) -> bytes:
    """Draws the trajectories of all recordings, and the links between them."""
    tracks, poses = merged.trajectories, merged.kept.keyframes.poses
    view = find_common_view([track.poses[:, :2] for track in tracks], MAP_SHAPE)
    figure, axes = make_world(view)
    for link in merged.links.loops:
        ends = poses[[link.earlier, link.later]]
        axes.plot(ends[:, 0], ends[:, 1], color=GREY, linewidth=1.6)
    for n, track in enumerate(tracks):
        axes.plot(track.poses[:, 0], track.poses[:, 1], color=_COLOURS[n % len(_COLOURS)], linewidth=1.0)
    return encode_png(figure)


def draw_change(points: NDArray[np.float64], change: Change, recording: int) -> bytes:
    """Draws the surroundings of a change in one recording.

    Args:
        points: (N, 2) of the recording [m].
        change: the change.
        recording: number of the recording.
    """
    x, y = change.place
    half = 0.5 * max(_SIDE_M, 2.0 * float(change.size_m.max()))
    view = View(x - half, x + half, y - half, y + half)
    figure, axes = make_square(view)
    counts, well_seen = count_points(axes, view, [points])
    lay_ink(axes, view, counts[0], well_seen, _COLOURS[recording % len(_COLOURS)])
    low = change.place - 0.5 * change.size_m - 1.0
    wide, high = change.size_m + 2.0
    axes.plot(low[0] + np.array([0, wide, wide, 0, 0]), low[1] + np.array([0, 0, high, high, 0]), color=RED, linewidth=1.5)
    return encode_png(figure)


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
