"""Makes the page of a localisation: the scans in the map, and how accurate their poses are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.config import Config, dump_yaml
from mqslam.core.keyframes import KeyframeMap
from mqslam.localisation.localise import Localised
from mqslam.localisation.registering import PlaceStatus
from mqslam.mapping.keyframing import render_keyframes
from mqslam.report.canvas import BLUE, INK, ORANGE, RED, VIOLET, Chart, Curve, Drawing, draw_chart, draw_world, over
from mqslam.report.page import Figure, Page, Section, Table
from mqslam.report.words import format_matched, format_value

_STATUSES: Final = {  # colour and mark on the map, and meaning
    PlaceStatus.CONVERGED: (BLUE, "o", "the scan lies on the map"),
    PlaceStatus.DEGENERATE: (ORANGE, "s", "the map does not show one direction; along it the pose is a prediction"),
    PlaceStatus.LOST: (RED, "^", "too little of the scan lies on the map; the pose is a prediction"),
    PlaceStatus.OUTSIDE: (VIOLET, "x", "no part of the map lies near the predicted pose; the pose is a prediction"),
}


def write_localise_page(
    folder: Path, localised: Localised, made: KeyframeMap, config: Config, summary: Mapping[str, Any]
) -> list[str]:
    """Writes the page of a localisation into an existing folder; the page needs no network.

    Args:
        folder: the folder.
        localised: poses of the scans in the map, with their statuses.
        made: the map.
        config: all settings.
        summary: content of summary.json.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: the file cannot be written.
    """
    dataset = summary["dataset"]
    title = f"Localisation of {Path(dataset['path']).name} in {Path(summary['map']['path']).name}"
    share = f"{format_matched(float(summary['share_on_map']))} of {format_value(dataset['scans'])} scans"
    page = Page(title, summary, dump_yaml(config), conclusion=f"{share} lie on the map.")
    page.add("the picture of the map", lambda: _show_map(made, localised))
    page.add("the numbers", lambda: _list_numbers(summary))
    page.add("the charts along the path", lambda: _show_path(localised))
    page.add("the table of the scans", lambda: _tabulate_statuses(summary))
    return page.write(folder)


def _list_numbers(summary: Mapping[str, Any]) -> Section:
    sigma, errors = summary["median_sigma"], summary["evaluation"]
    of_scans = [
        ("on the map", format_matched(summary["share_on_map"])),
        ("their returns on the map", format_matched(summary["matched"])),
        ("ψ per point on the map", format_value(summary["psi_per_point"])),
    ]
    of_poses = [
        ("along the heading", format_value(1e3 * sigma["along_m"], " mm")),
        ("across it", format_value(1e3 * sigma["across_m"], " mm")),
        ("heading", format_value(math.degrees(sigma["yaw_rad"]), "°")),
    ]
    numbers = [("Scans", of_scans), ("Standard deviations relative to the map around (medians)", of_poses)]
    if errors is not None:
        ate = format_value(errors["ate_rmse_m"], " m")
        numbers.append(("Errors against ground truth", [("ATE of all scans, after alignment", ate)]))
    return Section("Numbers", numbers=numbers)


def _show_map(made: KeyframeMap, localised: Localised) -> Section:
    """Returns a picture of the map with the positions of the scans, marked by the scans' status."""
    curves = []
    for status, (colour, mark, _) in _STATUSES.items():
        chosen = [one is status for one in localised.statuses]
        if any(chosen):
            curves.append(Curve(status.value, colour, localised.poses[chosen, :2], mark, 3.0))
    (picture,) = draw_world([Drawing([(render_keyframes(made.keyframes).points, INK)], curves)])
    return Section(
        "Map", figures=[Figure(picture, "Scans in the map", "the map in grey, and on it the scans by their status")]
    )


def _show_path(localised: Localised) -> Section:
    """Returns charts over time: standard deviations of each pose, and the share of each scan's returns on the map."""
    seconds = 1e-6 * (localised.stamps_us - localised.stamps_us[0])
    sigmas = np.sqrt(np.einsum("nii->ni", localised.covariances))
    curves = []
    for column, (name, colour) in enumerate((("along", BLUE), ("across", ORANGE))):
        for chosen, style, label in ((localised.on_map, "-", name), (~localised.on_map, ":", "")):
            values = np.where(chosen, sigmas[:, column], np.nan)
            curves.append(Curve(label, colour, over(seconds, values), style, 1.0))
    is_mixed = bool(localised.on_map.any() and not localised.on_map.all())  # predicted poses err by metres, others by mm
    caption = (
        "relative to the map around each pose, in the pose's own frame; errors of the map over kilometres are not included; "
        "dotted where the pose is a prediction"
    )
    overlap = Curve("", BLUE, over(seconds, 100.0 * localised.matched), width=1.0)
    return Section(
        "Along the recording",
        figures=[
            Figure(
                draw_chart(Chart("standard deviation [m]", tuple(curves), log=("y",) if is_mixed else ())),
                "Uncertainty of the poses",
                caption,
            ),
            Figure(
                draw_chart(Chart("matched share [%]", (overlap,), top=100.0)),
                "Overlap",
                "share of each scan's returns that lie on the map",
            ),
        ],
    )


def _tabulate_statuses(summary: Mapping[str, Any]) -> Section:
    rows = [(name, format_value(count), _STATUSES[PlaceStatus(name)][2]) for name, count in summary["scans"].items()]
    return Section("Scans", table=Table(("status", "scans", "meaning"), rows, holds_words=True))
