"""Makes the page of a merge: the maps of the recordings over each other, the links between them, and the changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.config import dump_yaml
from mqslam.merging.changes import Change
from mqslam.merging.merge import Merged
from mqslam.report.canvas import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SQUARE,
    VIOLET,
    Curve,
    Drawing,
    Points,
    View,
    draw_routes,
    draw_world,
    join_lines,
    over,
)
from mqslam.report.page import Card, Figure, Page, Section, Table
from mqslam.report.words import format_matched, format_value

# the looks of the page; no result depends on them
_COLOURS: Final = (("blue", BLUE), ("orange", ORANGE), ("green", GREEN), ("violet", VIOLET))
_SIDE_M: Final = 40.0  # least side of the picture of a change
_SHOWN: Final = 12  # most changes that have a picture of their own
_LISTED: Final = 25  # most changes in the table of the page; changes.csv has all


def write_merge_page(folder: Path, merged: Merged, summary: Mapping[str, Any]) -> list[str]:
    """Writes the page of a merge into an existing folder; the page needs no network.

    Args:
        folder: the folder.
        merged: result of the merge.
        summary: content of summary.json.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: the file cannot be written.
    """
    title, conclusion = f"Merge of {len(merged.trajectories)} recordings", f"{summary['conclusion']}."
    page = Page(title, summary, dump_yaml(merged.config), conclusion=conclusion)
    page.add("the pictures of the map", lambda: _show_map(merged))
    page.add("the numbers", lambda: _list_numbers(summary))
    page.add("the table of the changes", lambda: _tabulate_changes(summary))
    page.add("the pictures of the changes", lambda: _show_changes(merged))
    page.add("the table of the recordings", lambda: _tabulate_recordings(summary))
    page.add("the table of the recognition", lambda: _tabulate_recognition(summary))
    return page.write(folder)


def _list_numbers(summary: Mapping[str, Any]) -> Section:
    links, psi = summary["links"], summary["psi"]
    of_links = [
        ("between recordings", format_value(links["count"])),
        ("median residual [standard deviations]", format_value(links["residual_median"])),
    ]
    of_map = [
        ("ψ per point across recordings, each moved as a whole", f"{psi['across_before']:.3f}"),
        ("the same, merged", f"{psi['across_after']:.3f}"),
        ("points matched", format_matched(psi["matched"])),
        ("objects that changed", format_value(len(summary["changes"]))),
    ]
    return Section("Numbers", numbers=[("Links", of_links), ("Map", of_map)])


def _split_points(merged: Merged) -> list[tuple[Points, str]]:
    """Returns the points (N, 2) [m] of each recording in the merged map, and the recording's colour."""
    keyframes = merged.kept.keyframes
    owner = np.repeat(keyframes.origins, np.diff(keyframes.rows, axis=1)[:, 0])
    recordings = range(len(keyframes.recordings))
    return [(merged.map.points[owner == n], _COLOURS[n % len(_COLOURS)][1]) for n in recordings]


def _show_map(merged: Merged) -> Section:
    """Returns pictures of the maps of all recordings over each other, and of their trajectories with the links."""
    maps, poses = _split_points(merged), merged.kept.keyframes.poses[:, :2]
    colours = ", ".join(f"{_COLOURS[n % len(_COLOURS)][0]} is recording {n + 1}" for n in range(len(maps)))
    places = np.array([change.place for change in merged.changes]).reshape(-1, 2)
    links = join_lines([poses[[link.earlier, link.later]] for link in merged.links.loops])
    routes = [("", colour, track.poses[:, :2]) for (_, colour), track in zip(maps, merged.trajectories, strict=True)]
    return Section(
        "Map",
        figures=[
            Figure(
                draw_world([Drawing(maps, [Curve("", RED, places, "s", 5.0)])])[0],
                "Map",
                f"{colours}; red squares are changes",
            ),
            Figure(
                draw_world([Drawing((), [Curve("", GREY, links, width=1.6), *draw_routes(routes)])])[0],
                "Trajectories",
                "a grey line ties two places that are linked",
            ),
        ],
    )


def _tabulate_changes(summary: Mapping[str, Any]) -> Section:
    changes = summary["changes"]
    notes = [
        "A change is an object that several keyframes of one recording show and the other recording does not, although it "
        "sees something behind the place, from the same side and from no farther away. Changes are looked for only near "
        "links, where the pose of the recordings relative to each other is known well enough."
    ]
    if not changes:
        notes.append("No change was found.")
    if len(changes) > _LISTED:
        notes.append(f"The {_LISTED} largest of {len(changes)} are listed; changes.csv has all of them.")
    rows = [
        (
            str(n),
            f"recording {change['shown_by']}",
            f"recording {change['missed_by']}",
            f"({change['x']:z.1f}, {change['y']:z.1f}) m",
            f"{change['size_x']:.1f} m × {change['size_y']:.1f} m",
            format_value(change["seen"]),
            format_value(change["looks"]),
        )
        for n, change in enumerate(changes[:_LISTED], 1)
    ]
    head = ("change", "shown by", "not by", "place", "size", "keyframes that show it", "keyframes that look past it")
    return Section("Changes", notes, table=Table(head, rows) if rows else None)


def _show_changes(merged: Merged) -> Section | None:
    maps, cards = _split_points(merged), []
    for n, change in enumerate(merged.changes[:_SHOWN], 1):
        title = f"{n}. shown by recording {change.shown_by + 1} at ({change.place[0]:z.1f}, {change.place[1]:z.1f}) m"
        both = (change.shown_by, change.missed_by)
        pictures = zip(both, draw_change([maps[k] for k in both], change, merged.unit_m), strict=True)
        names = [(f"recording {k + 1}", picture) for k, picture in pictures]
        cards.append(Card(title, figures=[Figure(png, name, description=f"{title}, in {name}") for name, png in names]))
    return Section("The largest changes", ["The same square of the map in both recordings."], cards=cards) if cards else None


def draw_change(maps: Sequence[tuple[Points, str]], change: Change, unit_m: float = 1.0) -> list[bytes]:
    """Draws the surroundings of a change, as the content of a PNG file per recording.

    Args:
        maps: points (N, 2) x, y [m] in the merged map and colour of each recording.
        change: the change.
        unit_m: unit in which the map was made [m]: maps of rooms have a small unit, and their pictures a smaller square.
    """
    x, y = change.place
    half = 0.5 * max(_SIDE_M * unit_m, 2.0 * float(change.size_m.max()))
    reach = 0.5 * change.size_m + unit_m
    (left, low), (right, high) = change.place - reach, change.place + reach
    frame = Curve("", RED, over([left, right, right, left, left], [low, low, high, high, low]), width=1.5)
    view = View(x - half, x + half, y - half, y + half)
    return [draw_world([Drawing([one], [frame])], SQUARE, view=view, is_small=True)[0] for one in maps]


def _tabulate_recordings(summary: Mapping[str, Any]) -> Section:
    rows = [
        (
            str(n),
            recording["path"],
            format_value(recording["scans"]),
            format_value(recording["length_m"], " m"),
            format_value(recording["duration_s"], " s"),
        )
        for n, recording in enumerate(summary["recordings"], 1)
    ]
    return Section("Recordings", table=Table(("recording", "path", "scans", "path driven", "duration"), rows))


def _tabulate_recognition(summary: Mapping[str, Any]) -> Section:
    names = ("compared", "matches", "rows", "agreeing", "rivals", "ambiguous")
    rows = [
        (f"result {m['later']} in result {m['earlier']}", *(format_value(m[name]) for name in names))
        for m in summary["recognition"]
    ]
    note = (
        "Submaps of one result are looked up in the other result without a first guess of their place. Matches in rows must "
        "agree on the pose of one result relative to the other, and hardly any match may agree on a different pose. An "
        "ambiguous submap fits several places and is not used."
    )
    head = ("looked up", "compared", "matches", "rows", "matches that agree", "that agree on a different pose", "ambiguous")
    return Section("Recognition", [note], table=Table(head, rows))
