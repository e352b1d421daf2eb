"""Makes the page of an audit, its heat map, and the files of its bad places.

`mqslam.results.audit_results` explains the words of an audit, such as revisit, span, jump and torn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.rounds import AuditedTrajectory
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import apply_tolerance
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import AuditConfig, Config, dump_yaml
from mqslam.core.statistics import pick_evenly
from mqslam.errors import tolerate
from mqslam.execution.files import write_bytes
from mqslam.report.canvas import BLUE, GREY, RED, Chart, Curve, draw_chart, join_lines, mix_shades, over
from mqslam.report.crops import draw_crop, make_crop
from mqslam.report.explorer import LEAST_M, Layer, Place, chart_inflation, explain_torn, explore
from mqslam.report.heat_map import draw_heat_map, explain_heat_map
from mqslam.report.page import Card, Explorer, Figure, Page, Section, Table, tabulate_tests
from mqslam.report.spots import (
    BAD_PLACES,
    Spot,
    find_worst_spots,
    list_bad_places,
    list_unmatched,
    rank_spot,
    spot_of_window,
    spots_of_torn_pairs,
    write_bad_places,
)
from mqslam.report.words import format_length, format_value, list_facts, list_values, part_of

_MEASURES: Final = {  # label and unit of each measure, by the name of its field
    "map_entropy": ("mean map entropy", " nat"),
    "plane_variance": ("mean plane variance", " m²"),
    "joint_entropy": ("joint less separate entropy", " nat"),
    "grid_entropy": ("entropy per grid cell", " nat"),
}
_COMPARED: Final = (  # values shown before and after mending: label, part and key in the summary, and unit
    ("windows torn", "windows", "torn", ""),
    ("median inflation", "windows", "inflation_median", ""),
    ("jumps", "steps", "jumps", ""),
    ("spans torn", "spans", "torn", ""),
    ("revisits that are sure", "revisits", "sure", ""),
    ("revisits torn", "revisits", "torn", ""),
    ("median offset of two passes", "revisits", "median_m", " m"),
)
_GROUPS: Final = {
    "dataset": "Recording",
    "windows": "Windows",
    "steps": "Steps",
    "spans": "Spans",
    "pooled": "Pooled corrections",
    "final_psi": "Final ψ",
    "revisits": "Revisits",
}
_PLACE_HEAD: Final = ("", "what", "time", "place", "off by", "correction", "inflation", "verdict")
_FINE: Final = "The largest corrections of places that are not torn"
_MOST_WINDOWS, _MOST_PAIRS = 120, 40  # most windows and other torn places that can be clicked: they limit the page's size


def write_audit_page(
    folder: Path,
    title: str,
    audit: Audit,
    sweeps: Sweeps,
    config: Config,
    summary: Mapping[str, Any],
    mended: AuditedTrajectory | None = None,
) -> list[str]:
    """Writes an audit's page, its heat map and the files of its bad places into an existing folder.

    Args:
        folder: the folder.
        title: heading of the page.
        audit: judgement of the map.
        sweeps: the points that were judged.
        config: all settings.
        summary: content of audit.json; values that are absent or None are shown as not available.
        mended: the mended trajectory and its audit; None if mending was not asked for.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: a file cannot be written.
    """
    settings, turns, notes = (
        apply_tolerance(config.audit, config.verdict),
        summary.get("gyroscope"),
        list(summary.get("notes") or ()),
    )
    if turns is not None and turns["agrees"] is not False:
        notes.append(turns["statement"])
    facts = list_facts(summary, trajectory=summary.get("trajectory"))
    page = Page(title, summary, dump_yaml(config), facts=facts, notes=notes)
    with tolerate("heatmap.png", page.failures):
        write_bytes(folder / "heatmap.png", _draw_heat_map(sweeps, audit, opaque=True))
    with tolerate("the files of the bad places", page.failures):
        write_bad_places(folder, list_bad_places(sweeps, audit, settings))
    page.add_lead("the heat map", lambda: _show_verdict(sweeps, audit))
    page.add("the tests", lambda: tabulate_tests(summary, audit.own))
    page.add("the mended trajectory", lambda: _show_mended(audit, sweeps, summary, mended))
    page.add_explorer(
        lambda: explore_audit(sweeps, audit, settings),
        [("the charts over time", lambda: _show_charts(sweeps, audit, settings))],
    )
    page.add("the worst places", lambda: _list_worst(sweeps, audit, settings))
    page.add("what could not be judged", lambda: _list_unmatched(sweeps, audit, summary))
    page.add("the pictures of the worst places", lambda: _show_crops(sweeps, audit, settings))
    page.add("the table of numbers", lambda: _list_numbers(audit, summary))
    return page.write(folder)


def _draw_heat_map(sweeps: Sweeps, audit: Audit, *, opaque: bool = False) -> bytes:
    return draw_heat_map(sweeps.points, sweeps.poses[:, :2], audit, opaque=opaque)


def _show_verdict(sweeps: Sweeps, audit: Audit) -> Section:
    return Section("", figures=[Figure(_draw_heat_map(sweeps, audit), "Heat map", explain_heat_map(audit.windows))])


def _show_charts(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> Section | None:
    charts = []
    if audit.windows:
        bend = format_length(settings.bend_m)
        caption = f"a window is torn if it is above the threshold and its correction moves its points by more than {bend}"
        charts.append(Figure(draw_chart(chart_inflation(audit.windows)), "Inflation of the windows", caption))
    if audit.revisits:
        caption = f"a sure revisit is torn beyond the tolerance or {np.rad2deg(settings.torn_rad):.2g}° of turn"
        if any(revisit.stated_covariance is not None for revisit in audit.revisits):
            caption = "a revisit is torn where the covariances of measurement and trajectory do not explain the offset"
        chart = _chart_revisits(audit.revisits, settings, sweeps.travelled, "path [m]")
        charts.append(Figure(draw_chart(chart), "Offset of the revisits", caption))
    note = (
        f"Every {WINDOW} sweeps are compared with the best map that the same returns can make. Inflation is the squared "
        "correction that makes this best map, in units of its own covariance. No ground truth is used."
    )
    return Section("Windows and revisits", [note], figures=charts) if charts else None


def _chart_revisits(revisits: Sequence[RevisitAudit], settings: AuditConfig, x: np.ndarray, x_title: str) -> Chart:
    """Returns a chart of how far off the two passes of every revisit are [m], in three groups: not sure, not torn, torn.

    Args:
        revisits: the judged revisits.
        settings: settings of the audit.
        x: (S,) value on the x axis for every sweep; a revisit is drawn at its later sweep.
        x_title: title of the x axis.
    """
    kinds = (
        ("not sure", GREY, "s", [r for r in revisits if not r.sure]),
        ("revisits", BLUE, "o", [r for r in revisits if r.sure and not r.torn]),
        ("revisits: torn", RED, "^", [r for r in revisits if r.sure and r.torn]),
    )
    curves = []
    for name, colour, mark, some in kinds:
        points = over([x[r.registration.later] for r in some], np.maximum([r.distance_m for r in some], LEAST_M))
        if some:
            curves.append(Curve(f"{name} ({len(some)})", colour, points, mark, 4.0))
    level = (f"tolerance {settings.torn_m:g} m", settings.torn_m, RED)
    return Chart("revisits apart [m]", tuple(curves), (level,), log=("y",), x_title=x_title)


def _show_mended(
    audit: Audit, sweeps: Sweeps, summary: Mapping[str, Any], mended: AuditedTrajectory | None
) -> Section | None:
    """Returns a section that compares the maps and verdicts of the given and the mended trajectory; None if not mended."""
    after = part_of(summary, "mended")
    if mended is None or not after:
        return None
    figures = [
        Figure(_draw_heat_map(sweeps, audit), "As it was given"),
        Figure(_draw_heat_map(mended.sweeps, mended.audit), "Mended"),
    ]
    rows = [("verdict", *(VerdictStatus(shown["verdict"]["status"]) for shown in (summary, after)))]
    for label, part, key, unit in _COMPARED:
        rows.append((label, *(format_value(part_of(shown, part).get(key), unit) for shown in (summary, after))))
    verdict = after["verdict"]
    why = f"The mended trajectory is judged {verdict['status']}: {'; '.join(verdict['reasons'])}."
    table = Table(("", "as it was given", "mended"), rows)
    return Section("Mended", [str(after["sentence"]), why], figures=figures, table=table)


def explore_audit(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> Explorer | None:
    """Returns the interactive map of an audit, with charts of inflation and revisits over time; None without points.

    Args:
        sweeps: the points that were judged.
        audit: judgement of the map.
        settings: settings of the audit.
    """
    times = sweeps.times[0] + (sweeps.turns - sweeps.numbers[0]) * sweeps.revolution_s
    layer = Layer("trajectory", BLUE, sweeps.times, sweeps.poses[:, :2], sweeps.points, {"time": times})
    spots = _choose_spots(sweeps, audit, settings)
    torn = [sweeps.poses[[r.earlier, r.later], :2] for r in (one.registration for one in audit.revisits if one.torn)]
    charts = [chart_inflation(audit.windows)] if audit.windows else []
    sure = [r for r in audit.revisits if r.sure]
    if sure:
        charts.append(_chart_revisits(sure, settings, sweeps.times, "time [s]"))
    return explore(
        [layer],
        charts,
        [_show_spot(sweeps, spot) for spot in spots],
        (
            "Click a dot to see the place as it is and corrected: what was seen first blue, what was seen last orange.",
            explain_torn(settings),
        ),
        lines=[Curve(f"torn revisits ({len(torn)})", RED, join_lines(torn), width=2.0)],
        first=max(range(len(spots)), key=lambda k: rank_spot(spots[k]), default=0),
        is_calm=audit.verdict.status is VerdictStatus.PASS,
    )


def _choose_spots(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns the places that can be clicked, in the order of time.

    At most `_MOST_WINDOWS` are windows: the first torn windows, and other windows only if there is room for them. At most
    `_MOST_PAIRS` are jumps, torn spans, torn sums and torn revisits. Of too many places other than torn windows, some are
    picked evenly.
    """
    torn = [w for w in audit.windows if w.torn][:_MOST_WINDOWS]
    fine = [w for w in audit.windows if not w.torn]
    fine = [fine[k] for k in pick_evenly(len(fine), _MOST_WINDOWS - len(torn))]
    off = spots_of_torn_pairs(sweeps, audit, settings)
    spots = [spot_of_window(w) for w in [*torn, *fine]] + [off[k] for k in pick_evenly(len(off), _MOST_PAIRS)]
    return sorted(spots, key=lambda spot: spot.t1)


def _show_spot(sweeps: Sweeps, spot: Spot) -> Place:
    """Returns the texts and the crops that a click on a spot shows."""
    before, after = make_crop(sweeps, spot)
    colours = mix_shades(len(before))
    t0 = spot.t0 if spot.kind == "window" else spot.t1 - sweeps.revolution_s
    views = (("as it is", before, colours), ("corrected", after, colours))
    return Place(t0, spot.t1, spot.title, spot.text, views, spot.torn, spot.undecided is not None)


def _number_worst(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[list[tuple[int, Spot]]]:
    """Returns the worst places, numbered from 1, in two lists: the torn places, and the others."""
    spots = list(enumerate(find_worst_spots(sweeps, audit, settings), 1))
    return [[(k, spot) for k, spot in spots if spot.torn is wanted] for wanted in (True, False)]


def _list_worst(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> Section | None:
    """Returns a table of the worst torn places and, folded, of the worst places that are not torn; None without places."""
    torn, fine = _number_worst(sweeps, audit, settings)
    if not torn and not fine:
        return None
    notes = (
        "Torn places come first, the largest correction at the top." if torn else "No place is torn.",
        "The windows with the largest inflation follow. All listed places are well apart.",
        "A correction moves the end of a window, span or sum relative to its begin, the scans after a jump, or the later "
        "pass of a revisit. Its directions are as seen from the sensor.",
        f"{' and '.join(BAD_PLACES)} next to this page list all places that are torn or undecided.",
    )
    tables = [
        Table(_PLACE_HEAD, [(str(k), *spot.cells) for k, spot in some], True) if some else None for some in (torn, fine)
    ]
    folded = Section(_FINE, table=tables[1]) if fine else None
    return Section("Worst places", notes, table=tables[0], folded=folded)


def _list_unmatched(sweeps: Sweeps, audit: Audit, summary: Mapping[str, Any]) -> Section | None:
    """Returns a table of the places that could not be judged, with the file that lists each; None if all was judged."""
    rows = list_unmatched(sweeps, audit)
    blind = [str(line) for line in summary.get("not_judged") or ()]
    if not rows and not blind:
        return None
    table = Table(("what", "time", "place", "why", "where to look"), rows, holds_words=True) if rows else None
    notes = ("Nothing is known about these places: they may be good or bad.", *blind)
    return Section("What could not be matched", notes, table=table)


def _show_crops(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> Section | None:
    """Returns pictures of the worst places before and after correction, folded if not torn; None without places."""
    torn, fine = ([_show_crop(sweeps, k, spot) for k, spot in some] for some in _number_worst(sweeps, audit, settings))
    note = (
        "The points where the correction shows the most, seen from the sensor, ahead to the right. Blue is what was "
        "seen first, orange what was seen last: a wall in two colours is doubled."
    )
    folded = Section(_FINE, cards=fine) if fine else None
    return Section("Before and after", [note], cards=torn, folded=folded) if torn or fine else None


def _show_crop(sweeps: Sweeps, number: int, spot: Spot) -> Card:
    title = f"{number}. {spot.title}"
    before, after = draw_crop(make_crop(sweeps, spot))
    shown = (("as it is", before, "before"), ("corrected", after, "after"))
    figures = [Figure(picture, name, description=f"{title}, {when}") for name, picture, when in shown]
    return Card(title, spot.text, figures=figures)


def _list_numbers(audit: Audit, summary: Mapping[str, Any]) -> Section:
    """Returns the section of numbers at the end of an audit's page: by part of audit.json, and measures of the windows."""
    groups = []
    for part, heading in _GROUPS.items():  # psi per point is left out: by itself it may prefer a wrong map
        values = {key: value for key, value in part_of(summary, part).items() if key != "psi_per_point"}
        if values:
            groups.append((heading, list_values(part, values)))
    note = "The usual measures of a map depend on the place as much as on the trajectory: none judges a map by itself."
    if audit.windows:
        groups.append(("Measures of the windows: median (5 % to 95 %)", _list_measures(audit)))
    return Section("Numbers", [note], numbers=groups)


def _list_measures(audit: Audit) -> list[tuple[str, str]]:
    """Returns for each measure its name, and as text its median and its 5 % and 95 % quantiles.

    The quantiles are over the windows for which the measure is known; without such a window, the text has dashes.
    """
    windows = audit.windows
    measured = [
        ("ψ of a window per point", "", [w.bend.psi for w in windows]),
        ("ψ of a window per point at its best", "", [w.bend.psi_best for w in windows]),
        ("points matched", " %", [100.0 * w.bend.matched for w in windows]),
        *((*shown, [getattr(w.measures, name) for w in windows]) for name, shown in _MEASURES.items()),
    ]
    rows = []
    for label, unit, values in measured:
        known = [value for value in values if np.isfinite(value)]
        low, median, high = np.quantile(known, [0.05, 0.5, 0.95]).tolist() if known else [None] * 3
        rows.append((label, f"{format_value(median, unit)} ({format_value(low)} to {format_value(high)})"))
    return rows
