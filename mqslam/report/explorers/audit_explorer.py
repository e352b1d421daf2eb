"""What the interactive part of an audit's page shows."""

from __future__ import annotations

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import AuditConfig
from mqslam.core.statistics import pick_evenly
from mqslam.report.explorers.explorer import (
    FINE,
    TORN,
    Chart,
    Explorer,
    ExplorerCurve,
    ExplorerPlace,
    Layer,
    Lines,
    PlaceView,
    join_lines,
    mix_shades,
)
from mqslam.report.explorers.run_explorer import chart_inflation, describe_first, explain_torn
from mqslam.report.figures.canvas import BLUE, RED
from mqslam.report.figures.crops import make_crop
from mqslam.report.places.spots import Spot, rank_spot, spot_of_window, spots_of_torn_pairs

# limits of the page's size
_MOST_WINDOWS, _MOST_PAIRS = 120, 40  # windows, and what else is torn, that can be clicked
_LEAST_M = 1e-3  # smaller offsets are drawn as this on a logarithmic axis


def explore_audit(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> Explorer:
    """Returns the map, its windows' inflation and its revisits over time, and crops before and after their corrections.

    Args:
        sweeps: what was judged.
        audit: the windows and revisits, judged.
        settings: settings of the audit.
    """
    times = sweeps.times[0] + (sweeps.turns - sweeps.numbers[0]) * sweeps.revolution_s
    layer = Layer("trajectory", BLUE, sweeps.times, sweeps.poses[:, :2], sweeps.points, {"time": times})
    spots = _choose_spots(sweeps, audit, settings)
    torn = [sweeps.poses[[r.revisit.earlier, r.revisit.later], :2] for r in audit.revisits if r.torn]
    lines = (Lines(f"torn revisits ({len(torn)})", RED, join_lines(torn), 2.0),) if torn else ()
    worst = max(range(len(spots)), key=lambda k: rank_spot(spots[k]), default=0)
    calm = audit.status is VerdictStatus.PASS
    return Explorer(
        layers=(layer,),
        charts=_make_charts(sweeps, audit, settings),
        places=tuple(_show_spot(sweeps, spot) for spot in spots),
        lines=lines,
        first=worst,
        first_is=describe_first(calm, bool(spots) and spots[worst].torn),
        calm=calm,
        explained=(
            "Click a dot to see the place as it is and corrected: what was seen first blue, what was seen last orange.",
            explain_torn(settings),
        ),
    )


def _choose_spots(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns windows, all torn ones and others evenly spread, and what else is torn, in the order of time."""
    torn = [w for w in audit.windows if w.torn][:_MOST_WINDOWS]
    fine = [w for w in audit.windows if not w.torn]
    fine = [fine[k] for k in pick_evenly(len(fine), _MOST_WINDOWS - len(torn))]
    off = spots_of_torn_pairs(sweeps, audit, settings)
    spots = [spot_of_window(w) for w in [*torn, *fine]] + [off[k] for k in pick_evenly(len(off), _MOST_PAIRS)]
    return sorted(spots, key=lambda spot: spot.t1)


def _show_spot(sweeps: Sweeps, spot: Spot) -> ExplorerPlace:
    """Returns what is shown of a spot when it is clicked."""
    crop = make_crop(sweeps, spot)
    colours = mix_shades(len(crop.before))
    views = (PlaceView("as it is", crop.before, colours), PlaceView("corrected", crop.after, colours))
    t0 = spot.t0 if spot.kind == "window" else spot.t1 - sweeps.revolution_s
    return ExplorerPlace(t0, spot.t1, crop.title, crop.text, spot.torn, views, spot.unknown)


def _make_charts(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> tuple[Chart, ...]:
    charts = []
    if audit.windows:
        charts.append(chart_inflation("inflation", audit.windows, BLUE))
    curves = []
    kinds = ((False, BLUE, "revisits", FINE), (True, RED, "revisits: torn", TORN))
    for torn, colour, name, mark in kinds:
        shown = [r.revisit for r in audit.revisits if r.revisit.sure and r.torn is torn]
        if shown:
            times = np.array([sweeps.times[r.later] for r in shown])
            curves.append(
                ExplorerCurve(name, colour, times, np.maximum([r.distance_m for r in shown], _LEAST_M), True, mark)
            )
    if curves:
        level = (f"tolerance {settings.torn_m:g} m", settings.torn_m, RED)
        charts.append(Chart("revisits apart [m]", tuple(curves), (level,), log=True))
    return tuple(charts)
