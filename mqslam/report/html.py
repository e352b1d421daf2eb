"""The report's page: HTML with its style and pictures inside, nothing fetched from anywhere."""

from __future__ import annotations

import base64
import math
import platform
from collections import Counter
from collections.abc import Mapping
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam import se2
from mqslam.evaluation import alignment
from mqslam.files import write_text
from mqslam.report import figures
from mqslam.report.content import Report, WindowScores
from mqslam.report.style import CSS
from mqslam.trajectory import Trajectory

_ABSENT: Final = "–"
_SAME_PATH_M: Final = 1e-3
_PACKAGES: Final = ("numpy", "scipy", "numba", "gtsam", "open3d", "kiss-icp", "matplotlib")
_GROUPS: Final = {
    "dataset": "Recording",
    "factors": "Graph factors",
    "evaluation": "Against ground truth",
    "runtime_s": "Run time",
}
_LABELS: Final = {
    "dataset.duration_s": ("duration", " s"),
    "dataset.length_m": ("length of path", " m"),
    "factors.loop": ("loop closures", ""),
    "factors.loop_rejected": ("loop closures rejected", ""),
    "evaluation.ate_rmse_m": ("ATE, RMSE", " m"),
    "evaluation.drift_percent": ("drift", " %"),
    "evaluation.drift_deg_per_100m": ("rotation drift", " °/100 m"),
    "evaluation.rpe_v_rms": ("speed error, RMS", " m/s"),
    "evaluation.rpe_w_rms": ("yaw rate error, RMS", " rad/s"),
    "evaluation.rpe_v_bias": ("speed error, mean", " m/s"),
    "evaluation.rpe_w_bias": ("yaw rate error, mean", " rad/s"),
}


def write_report(path: Path, report: Report) -> None:
    """Write a run's report as one HTML file that opens without a network.

    Raises:
        OutputError: the file cannot be written.
    """
    write_text(path, _page(report))


def _page(report: Report) -> str:
    title = escape(report.title)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title} · mqslam</title>
<style>{CSS}</style>
</head>
<body>
<header>
<h1>{title}</h1>
{_warnings(report.warnings)}
{_verdict(_section(report.summary, "verdict"))}
</header>
<main>
{_tiles(report)}
{_maps(report)}
{_trajectory_and_windows(report)}
{_tables(report)}
<details class="card"><summary>Settings</summary><pre>{escape(report.settings_yaml)}</pre></details>
</main>
<footer>{escape(_versions(report.summary))}</footer>
</body>
</html>
"""


def _warnings(warnings: tuple[str, ...]) -> str:
    if not warnings:
        return ""
    items = "".join(f"<li>{escape(w)}</li>" for w in warnings)
    return f'<section class="warnings"><h2>Warnings</h2><ul>{items}</ul></section>'


def _verdict(verdict: Mapping[str, Any]) -> str:
    status = str(verdict.get("status") or "no verdict")
    kind = status if status in ("pass", "warn", "fail") else "none"
    reasons = "".join(f"<li>{escape(str(r))}</li>" for r in verdict.get("reasons") or ())
    listed = f"<ul>{reasons}</ul>" if reasons else ""
    return f'<section class="verdict"><span class="badge {kind}">{escape(status)}</span>{listed}</section>'


def _tiles(report: Report) -> str:
    psi, dataset = _section(report.summary, "psi"), _section(report.summary, "dataset")
    evaluation = _section(report.summary, "evaluation")
    before, after = psi.get("per_point_odometry"), psi.get("per_point_optimised")
    tiles = [
        (_number(after), "ψ per point of the optimised map"),
        (_change(before, after), "change of ψ per point from odometry"),
        (_share(psi.get("matched_optimised")), "of its points matched"),
        (_number(dataset.get("length_m"), " m"), f"driven in {_number(dataset.get('duration_s'), ' s')}"),
    ]
    if evaluation:
        tiles.append((_number(evaluation.get("ate_rmse_m"), " m"), "absolute error against ground truth (RMSE)"))
        tiles.append((_number(evaluation.get("drift_percent"), " %"), "drift against ground truth"))
    shown = "".join(f'<div class="tile"><b>{escape(v)}</b><span>{escape(label)}</span></div>' for v, label in tiles)
    return f'<div class="tiles">{shown}</div>'


def _maps(report: Report) -> str:
    before, after = figures.map_figures(
        (report.map_odometry, report.map_optimised),
        (report.odometry, report.optimised),
        (figures.ODOMETRY_COLOUR, figures.OPTIMISED_COLOUR),
    )
    psi = _section(report.summary, "psi")
    note = (
        '<p class="soft">Every return of the run, stronger where more fell, on one extent and one scale; '
        f"up to {100.0 * figures.OUTERMOST:g} % of the points may lie beyond each edge.</p>"
    )
    if _same_path(report.odometry, report.optimised):
        note += (
            '<p class="soft">Optimisation left the trajectory as it was, so both maps are the same: '
            "nothing in the graph contradicted the odometry.</p>"
        )
    pictures = _picture(
        before,
        "Under odometry",
        f"ψ per point {_number(psi.get('per_point_odometry'))}, {len(report.map_odometry):,} points",
    ) + _picture(
        after,
        "Optimised",
        f"ψ per point {_number(psi.get('per_point_optimised'))}, {len(report.map_optimised):,} points",
    )
    return f'<h2>Map</h2>{note}<div class="pair">{pictures}</div>'


def _trajectory_and_windows(report: Report) -> str:
    truth = _placed_truth(report)
    drawn = figures.trajectory_figure(report.odometry, report.optimised, truth)
    caption = "ground truth laid on the optimised trajectory by the best rigid motion" if truth is not None else ""
    trajectory = _picture(drawn, "Trajectory", caption)
    if len(report.windows) == 0:
        return f'<h2>Trajectory</h2><div class="pair">{trajectory}</div>'
    scores = _picture(figures.psi_figure(report.windows), "ψ per window", _statuses(report.windows))
    matched = _picture(
        figures.matched_figure(report.windows), "Matched share", "points with a neighbour that takes part in the score"
    )
    stacked = f'<div class="stack">{scores}{matched}</div>'
    return f'<h2>Trajectory and windows</h2><div class="pair">{trajectory}{stacked}</div>'


def _placed_truth(report: Report) -> Trajectory | None:
    """The ground truth in the frame of the optimised trajectory, or None where the two cannot be aligned."""
    if report.ground_truth is None:
        return None
    motion = alignment(report.optimised, report.ground_truth)
    if motion is None:
        return None
    return Trajectory(report.ground_truth.stamps_us, se2.compose(se2.inverse(motion), report.ground_truth.poses))


def _statuses(windows: WindowScores) -> str:
    counts = Counter(windows.status)
    return f"{len(windows):,} windows: " + ", ".join(f"{n:,} {status}" for status, n in counts.most_common())


def _tables(report: Report) -> str:
    cards = [_psi_table(report)]
    for group, heading in _GROUPS.items():
        values = _section(report.summary, group)
        unit = " s" if group == "runtime_s" else ""
        rows = "".join(_row(group, key, value, unit) for key, value in values.items())
        if group == "runtime_s" and report.summary.get("peak_rss_mb") is not None:
            rows += f"<tr><th>peak memory</th><td>{escape(_number(report.summary['peak_rss_mb'], ' MB'))}</td></tr>"
        if rows:
            cards.append(f'<section class="card"><h3>{heading}</h3><table>{rows}</table></section>')
    return f'<h2>Numbers</h2><div class="tables">{"".join(cards)}</div>'


def _psi_table(report: Report) -> str:
    psi = _section(report.summary, "psi")
    matched = [psi.get("matched_odometry"), psi.get("matched_optimised")]
    per_point = [psi.get("per_point_odometry"), psi.get("per_point_optimised")]
    total = [psi.get("odometry"), psi.get("optimised")]
    rows = [
        ("ψ", _number(total[0]), _number(total[1]), _change(*total)),
        ("ψ per point", _number(per_point[0]), _number(per_point[1]), _change(*per_point)),
        ("points matched", _share(matched[0]), _share(matched[1]), _change(*matched)),
        ("points", f"{len(report.map_odometry):,}", f"{len(report.map_optimised):,}", ""),
        ("path", _number(report.odometry.length_m, " m"), _number(report.optimised.length_m, " m"), ""),
    ]
    body = "".join(
        f"<tr><th>{escape(label)}</th>" + "".join(f"<td>{escape(v)}</td>" for v in values) + "</tr>"
        for label, *values in rows
    )
    head = "<thead><tr><th></th><th>odometry</th><th>optimised</th><th>change</th></tr></thead>"
    table = f'<table class="numbers">{head}<tbody>{body}</tbody></table>'
    return f'<section class="card wide"><h3>Map quality</h3>{table}</section>'


def _row(group: str, key: str, value: Any, unit: str) -> str:
    label, own_unit = _LABELS.get(f"{group}.{key}", (key.replace("_", " "), unit))
    return f"<tr><th>{escape(label)}</th><td>{escape(_number(value, own_unit))}</td></tr>"


def _picture(png: bytes, heading: str, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    detail = f"<span>{escape(caption)}</span>" if caption else ""
    return (
        f"<figure><figcaption><b>{escape(heading)}</b>{detail}</figcaption>"
        f'<img alt="{escape(heading)}" src="data:image/png;base64,{data}"></figure>'
    )


def _section(summary: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = summary.get(key)
    return value if isinstance(value, Mapping) else {}


def _number(value: Any, unit: str = "") -> str:
    """A value of the summary as text: four digits that count, thousands separated, a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return _ABSENT
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}{unit}"
    if isinstance(value, float):
        digits = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        return f"{digits}{unit}"
    return f"{value}{unit}"


def _share(value: Any) -> str:
    return _number(100.0 * value, " %") if isinstance(value, int | float) else _ABSENT


def _change(before: Any, after: Any) -> str:
    if not isinstance(before, int | float) or not isinstance(after, int | float) or before == 0:
        return _ABSENT
    return f"{100.0 * (after - before) / abs(before):+.1f} %".replace("-", "−")


def _same_path(a: Trajectory, b: Trajectory) -> bool:
    return np.array_equal(a.stamps_us, b.stamps_us) and bool(
        np.all(np.abs(a.poses[:, :2] - b.poses[:, :2]) < _SAME_PATH_M)
    )


def _versions(summary: Mapping[str, Any]) -> str:
    found = [f"mqslam {summary.get('mqslam_version', _ABSENT)}", f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return " · ".join(found)
