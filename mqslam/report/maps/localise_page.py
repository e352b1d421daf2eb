"""The page of a localisation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.config import Config, dump_yaml
from mqslam.core.keyframes import KeyframeMap, Keyframes
from mqslam.errors import tolerate
from mqslam.localisation.localise import Localised
from mqslam.localisation.registering import PlaceStatus
from mqslam.mapping.keyframing import render_keyframes
from mqslam.report.content import Figure, Frame, PagePart, Section, Table, TableRow, Tile
from mqslam.report.figures.canvas import (
    BLUE,
    MAP_SHAPE,
    ORANGE,
    OUTERMOST,
    RED,
    VIOLET,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_chart,
    make_world,
    put_legend_above,
)
from mqslam.report.figures.svg import encode_svg
from mqslam.report.formatting import format_matched, format_value
from mqslam.report.page import collect, version_in, write_page

# the looks of the figures; no result depends on them
_LOOKS: Final = {
    PlaceStatus.CONVERGED: (BLUE, "."),
    PlaceStatus.DEGENERATE: (ORANGE, "s"),
    PlaceStatus.LOST: (RED, "^"),
    PlaceStatus.OUTSIDE: (VIOLET, "x"),
}


def draw_scans_in_map(keyframes: Keyframes, localised: Localised) -> bytes:
    """Draws a map, and the scans that were found in it by their status."""
    points, places = render_keyframes(keyframes).points, localised.poses[:, :2]
    view = find_common_view([points, places], MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view)
    (counts,), well_seen = count_points(axes, view, [points])
    lay_ink(axes, view, counts, well_seen)
    for status, (colour, marker) in _LOOKS.items():
        chosen = np.array([one is status for one in localised.statuses], dtype=np.bool_)
        if chosen.any():
            axes.plot(*places[chosen].T, marker, color=colour, markersize=3.0, label=status.value)
    put_legend_above(axes)
    return encode_png(figure)


def draw_uncertainty(localised: Localised) -> bytes:
    """Draws the standard deviation of each pose on the map over time."""
    seconds = 1e-6 * (localised.stamps_us - localised.stamps_us[0])
    sigmas = np.sqrt(np.einsum("nii->ni", localised.covariances))
    figure, axes = make_chart("standard deviation [m]")
    for column, (name, colour) in enumerate((("along", BLUE), ("across", ORANGE))):
        for chosen, style in ((localised.on_map, "-"), (~localised.on_map, ":")):
            shown = np.where(chosen, sigmas[:, column], np.nan)
            axes.plot(seconds, shown, style, color=colour, linewidth=1.0, label=name if style == "-" else None)
    if localised.on_map.any() and not localised.on_map.all():  # predictions are unsure by metres, poses by millimetres
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    put_legend_above(axes)
    return encode_svg(figure)


def draw_overlap(localised: Localised) -> bytes:
    """Draws over time what share of each scan's returns lies on the map."""
    seconds = 1e-6 * (localised.stamps_us - localised.stamps_us[0])
    figure, axes = make_chart("matched share [%]")
    axes.plot(seconds, 100.0 * localised.matched, color=BLUE, linewidth=1.0)
    axes.set_ylim(0.0, 100.0)
    return encode_svg(figure)


_MEANINGS: Final = {
    "converged": "the scan lies on the map",
    "degenerate": "the map does not show one direction; along it the motion counts",
    "lost": "too little of the scan lies on the map; the pose is a prediction",
    "outside": "the map has nothing there; the pose is a prediction",
}


@dataclass(frozen=True, slots=True)
class LocaliseParts:
    """The parts of the page, as localise.html shows them."""

    tiles: PagePart[tuple[Tile, ...]]
    map: PagePart[Section]
    path: PagePart[Section]
    statuses: PagePart[Section]


def write_localise_page(
    folder: Path, localised: Localised, made: KeyframeMap, config: Config, summary: Mapping[str, Any]
) -> list[str]:
    """Writes the page of a localisation into an existing folder, as one HTML file that opens without a network.

    Args:
        folder: the folder.
        localised: where the scans lie.
        made: the map.
        config: all settings.
        summary: content of summary.json.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    parts = LocaliseParts(
        tiles=collect("the first numbers", lambda: _make_tiles(summary), failures),
        map=collect("the picture of the map", lambda: _show_map(made, localised), failures),
        path=collect("the charts along the path", lambda: _show_path(localised), failures),
        statuses=collect("the table of the scans", lambda: _tabulate_statuses(summary), failures),
    )
    dataset, share = summary["dataset"], float(summary["share_on_map"])
    frame = Frame(
        title=f"Localisation of {Path(dataset['path']).name} in {Path(summary['map']['path']).name}",
        settings_yaml=dump_yaml(config),
        version=version_in(summary),
        warnings=(*summary["warnings"], *failures),
        conclusion=f"{format_matched(share)} of {format_value(dataset['scans'])} scans lie on the map.",
    )
    with tolerate("report.html", failures):
        write_page(folder / "report.html", "localise.html", frame, parts)
    return failures


def _make_tiles(summary: Mapping[str, Any]) -> tuple[Tile, ...]:
    sigma, errors = summary["median_sigma"], summary["evaluation"]
    return (
        Tile(format_matched(summary["share_on_map"]), "of all scans on the map"),
        Tile(format_value(1e3 * sigma["along_m"], " mm"), "along the heading against the map around (median of one sigma)"),
        Tile(format_value(1e3 * sigma["across_m"], " mm"), "across it"),
        Tile(format_value(math.degrees(sigma["yaw_rad"]), "°"), "heading"),
        Tile(format_matched(summary["matched"]), "of the returns on the map"),
        Tile(format_value(summary["psi_per_point"]), "ψ per point on the map"),
        *(() if errors is None else (Tile(format_value(errors["ate_rmse_m"], " m"), "ATE of all scans, after alignment"),)),
    )


def _show_map(made: KeyframeMap, localised: Localised) -> Section:
    note = "the map in grey, and on it the scans by their status"
    return Section("Map", (), (Figure(draw_scans_in_map(made.keyframes, localised), "Scans in the map", note),))


def _show_path(localised: Localised) -> Section:
    surety = (
        "against the map around each pose, in its own frame; how far the map is bent over kilometres is not in it; "
        "dotted where the pose is a prediction"
    )
    figures = (
        Figure(draw_uncertainty(localised), "How sure the poses are", surety),
        Figure(draw_overlap(localised), "Overlap", "share of each scan's returns that lie on the map"),
    )
    return Section("Along the recording", (), figures)


def _tabulate_statuses(summary: Mapping[str, Any]) -> Section:
    rows = tuple(TableRow(name, (format_value(count), _MEANINGS[name])) for name, count in summary["scans"].items())
    return Section("Scans", (), table=Table(("status", "scans", "meaning"), rows, holds_words=True))
