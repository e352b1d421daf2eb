"""Writes the results of a comparison: a folder per row (front end or trajectory), and all numbers as JSON, CSV and text."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.speeds import contradicts
from mqslam.auditing.verdict import VerdictStatus
from mqslam.comparison.best import Standing
from mqslam.comparison.comparison import Comparison
from mqslam.comparison.judgement import JudgedRow
from mqslam.comparison.rows import Row
from mqslam.config import dump_yaml
from mqslam.core.measurement import Status
from mqslam.core.recording import Recording
from mqslam.core.wording import join_words
from mqslam.errors import show
from mqslam.evaluation import NO_DRIFT
from mqslam.execution.files import write_json, write_text
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import write_tum
from mqslam.results.files import format_csv, format_log, list_notes, summarise_size
from mqslam.results.run_results import format_measurements, write_marginals
from mqslam.results.run_verdict import warn_of_lost
from mqslam.version import __version__


class _Column(NamedTuple):
    """A column of the table that compares the rows.

    Args:
        key: key of the value in a row of compare.json.
        head: heading of the column.
        form: format of a value, such as `{:.3f}`.
        arrow: which values are better: smaller (↓), larger (↑), or nearer to 1 (→ 1); empty if no value is better.
    """

    key: str
    head: str
    form: str
    arrow: Literal["↓", "↑", "→ 1", ""] = ""


_BADNESS: Final[dict[str, Callable[[float], float]]] = {
    "↓": lambda value: value,
    "↑": lambda value: -value,
    "→ 1": lambda value: abs(value - 1.0) / (value + 1.0),  # 2 and 0.5 are equally far from 1
}
_COLUMNS: Final = (
    _Column("drift_percent", "drift [%]", "{:.3f}", "↓"),
    _Column("drift_deg_per_100m", "[deg/100 m]", "{:.3f}", "↓"),
    _Column("ate_rmse_m", "ATE [m]", "{:.3f}", "↓"),
    _Column("rpe_v_rms", "speed error [m/s]", "{:.3f}", "↓"),
    _Column("odometry_drift_percent", "before back end [%]", "{:.3f}", "↓"),
    _Column("nees_per_degree", "NEES/3", "{:.2f}", "→ 1"),
    _Column("psi_across_passes", "psi across passes", "{:z.4f}", "↓"),
    _Column("psi_over_best", "psi over its best", "{:.2f}", "↓"),
    _Column("matched", "matched", "{:.1%}", "↑"),
    _Column("lost", "lost", "{:.1%}", "↓"),
    _Column("verdict", "verdict", "{}"),
    _Column("inflation", "inflation", "{:.3g}", "↓"),
    _Column("windows_torn", "windows torn", "{:.1%}", "↓"),
    _Column("revisit_m", "revisits apart [m]", "{:.3f}", "↓"),
    _Column("loops", "loops", "{}"),
    _Column("ms_per_revolution", "time [ms/rev]", "{:.1f}", "↓"),
    _Column("back_end_s", "back end [s]", "{:.1f}", "↓"),
    _Column("peak_rss_mb", "memory [MB]", "{:.0f}", "↓"),
)


def summarise(comparison: Comparison) -> dict[str, Any]:
    """Returns the content of compare.json: the numbers of each row, the best rows, and how far the rows agree."""
    recording = comparison.recording
    judged, across, best = comparison.judged, comparison.psi_across, comparison.best
    return {
        "mqslam_version": __version__,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            **summarise_size(recording),
            "compared": comparison.compared,
        },
        "doppler_beta": comparison.doppler_beta,
        "threshold": TORN_INFLATION,
        "warnings": [
            *comparison.warnings,
            *(f"{row.name}: {line}" for row in comparison.rows for line in warn_of_lost(row.measurements)),
        ],
        "best": best and {"rows": list(best.rows), "decided_by": best.decided_by, "sentence": best.sentence},
        "rows": [
            _list_row(row, judged.get(row.name), across.get(row.name), comparison, len(recording)) for row in comparison.rows
        ],
        "agreement": [
            {"row": a, "against": b, "rmse_m": e.ate_rmse_m, "drift_percent": e.drift_percent, "speed_rms": e.rpe_v_rms}
            for a, b, e in comparison.agreement
        ],
        "places": [{"t0": p.t0, "t1": p.t1, "apart_m": p.apart_m} for p in comparison.places],
    }


def _list_row(
    row: Row, judged: JudgedRow | None, across: float | None, comparison: Comparison, scans: int
) -> dict[str, Any]:
    """Returns the entry of compare.json on a row; for a row that was not judged (`judged` is None), its name and failure.

    The psi across passes, `across`, is None if it is not known. The recording has `scans` scans.
    """
    if judged is None:
        return {"name": row.name, "failure": row.failure}
    windows, sure = judged.audit.windows, [r for r in judged.audit.revisits if r.sure]
    standing = Standing.of(judged)
    torn = standing.windows
    truth, before = judged.after, judged.before
    return {
        "name": row.name,
        "failure": None,
        "scans": comparison.covered.get(row.name, 0),
        "interpolated": comparison.interpolated.get(row.name, 0),
        "drift_percent": truth and truth.drift_percent,
        "drift_deg_per_100m": truth and truth.drift_deg_per_100m,
        "ate_rmse_m": truth and truth.ate_rmse_m,
        "rpe_v_rms": truth and truth.rpe_v_rms,
        "rpe_w_rms": truth and truth.rpe_w_rms,
        "odometry_drift_percent": before and before.drift_percent,
        "odometry_drift_deg_per_100m": before and before.drift_deg_per_100m,
        "odometry_ate_rmse_m": before and before.ate_rmse_m,
        "nees_per_degree": judged.nees,
        "lost": np.mean([m.status is Status.LOST for m in row.measurements]).item() if row.measurements else None,
        "verdict": judged.audit.verdict.status,
        "reasons": "; ".join(judged.audit.verdict.reasons),
        "psi_across_passes": across,
        "psi_per_point": judged.psi_per_point,
        "psi_over_best": judged.audit.compute_psi_over_best(),
        "matched": judged.matched,
        "inflation": _find_median_inflation(judged.audit),
        "windows": len(windows),
        "windows_torn": torn.count / torn.total if torn.total else None,
        "windows_torn_at_least": torn.lower_bound(),
        "windows_torn_at_most": torn.upper_bound(),
        "revisits": standing.revisits.total,
        "revisits_torn": standing.revisits.count,
        "revisit_m": float(np.median([r.distance_m for r in sure])) if sure else None,
        "loops": row.loops if row.measurements else None,
        "loops_rejected": row.loops_rejected if row.measurements else None,
        "measure_s": row.measure_s,
        "ms_per_revolution": None if row.measure_s is None else 1e3 * row.measure_s / scans,
        "back_end_s": row.back_end_s,
        "peak_rss_mb": row.peak_rss_mb,
    }


def _find_median_inflation(audit: Audit) -> float | None:
    """Returns the median inflation of windows; None if at least half are undecided or contradicted by their speed checks."""
    unknown = [w.undecided is not None or contradicts(w.speed, audit.capture) for w in audit.windows]
    values = [np.inf if no else w.bend.inflation for w, no in zip(audit.windows, unknown, strict=True)]
    median = float(np.median(values)) if values else np.inf
    return median if np.isfinite(median) else None


def tabulate(summary: Mapping[str, Any]) -> tuple[list[list[str]], frozenset[tuple[int, int]]]:
    """Returns the table of a comparison as text for people.

    Columns without values are left out. Psi per point of the whole map has no column, because a worse map may have a smaller
    value: psi of a whole map mostly compares scans that follow each other.

    Args:
        summary: content of compare.json.

    Returns:
        The lines of the table, each a list of cells, with the head as line 0, and (line, column) of each best value. Only
        columns with an arrow, and with values in two rows or more, have best values; values with equal texts are equal.
    """
    rows: list[dict[str, Any]] = summary["rows"]
    shown = [column for column in _COLUMNS if any(row.get(column.key) is not None for row in rows)]
    cells = [["", *(f"{column.head} {column.arrow}".rstrip() for column in shown)]]
    for row in rows:
        if row["failure"] is not None:
            cells.append([row["name"], f"failed: {row['failure']}", *[""] * (len(shown) - 1)])
            continue
        cells.append([row["name"], *(_format_cell(row[column.key], column.form) for column in shown)])
    return cells, frozenset((line, k) for k, column in enumerate(shown, 1) for line in _find_best_lines(column, rows))


def explain_table(summary: Mapping[str, Any], marked: Collection[tuple[int, int]], mark: str) -> list[str]:
    """Returns the notes that stand below the table of a comparison.

    They say how the best values are marked, which rows lack scans or are interpolated, and why there is no drift.

    Args:
        summary: content of compare.json.
        marked: the places of the best values; see `tabulate`.
        mark: how the best values are marked, such as `Bold`.
    """
    dataset, rows, notes = summary["dataset"], summary["rows"], []
    if marked:
        near = "→ 1 nearer to 1 is better (2 is as near as 0.5)"
        notes.append(f"{mark} is the best value; ↓ less is better, ↑ more is better, {near}.")
    short = [row for row in rows if row.get("scans", dataset["revolutions"]) < dataset["revolutions"]]
    if short:
        covered = join_words([f"{row['name']} covers {row['scans']}" for row in short])
        judged = f"every row is judged on the {dataset['compared']} that all rows cover"
        notes.append(f"Of {dataset['revolutions']} scans, {covered}; {judged}.")
    between = [f"{row['interpolated']} scans of {row['name']}" for row in rows if row.get("interpolated")]
    if between:
        notes.append(f"No pose lies near {join_words(between)}: there the poses are interpolated between distant ones.")
    if {row["drift_percent"] for row in rows if row.get("ate_rmse_m") is not None} == {None}:
        notes.append(f"Drift is {NO_DRIFT}.")
    return notes


def format_markdown(cells: Sequence[Sequence[str]], marked: Collection[tuple[int, int]], notes: Sequence[str] = ()) -> str:
    """Returns a table as Markdown, with the best values, which are at the places `marked`, bold; see `tabulate`.

    A list of the `notes` stands below the table.
    """
    lines = []
    for k, line in enumerate(cells):
        words = [text.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for text in line]
        lines.append("| " + " | ".join(f"**{text}**" if (k, j) in marked else text for j, text in enumerate(words)) + " |")
    lines.insert(1, "|---|" + "---:|" * (len(cells[0]) - 1))
    below = [f"- {note}" for note in notes]
    return "\n".join([*lines, *([""] if below else []), *below]) + "\n"


_LATEX: Final = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\n": " "}
    | {"↓": r"$\downarrow$", "↑": r"$\uparrow$", "→": r"$\rightarrow$", "±": r"$\pm$"}
)


def format_latex(cells: Sequence[Sequence[str]], marked: Collection[tuple[int, int]], notes: Sequence[str] = ()) -> str:
    """Returns a table as LaTeX for the package booktabs, with a column for each row of the comparison and best values bold.

    Rows that failed have no column; comments below the table name them, and hold the notes.

    Args:
        cells: the lines of the table, its head first, as `tabulate` returns them.
        marked: (line, column) of the best values.
        notes: what a reader of the table must know.
    """
    ran = [k for k, line in enumerate(cells) if not line[1].startswith("failed: ")]
    lines = [rf"\begin{{tabular}}{{l{'r' * (len(ran) - 1)}}}", r"\toprule"]
    for j in range(len(cells[0])):
        words = [cells[k][j].translate(_LATEX) for k in ran]
        bold = (rf"\textbf{{{text}}}" if (k, j) in marked else text for k, text in zip(ran, words, strict=True))
        lines += [" & ".join(bold) + r" \\", *([r"\midrule"] if j == 0 else [])]
    failed = [line[0] + " " + line[1] for k, line in enumerate(cells) if k not in ran]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", *(f"% {show(line)}" for line in (*failed, *notes))]) + "\n"


def _find_best_lines(column: _Column, rows: Sequence[Mapping[str, Any]]) -> list[int]:
    """Returns the numbers of the lines with a column's best value, as `tabulate` counts them; empty if no value is best."""
    values = {line: row[column.key] for line, row in enumerate(rows, 1) if row.get(column.key) is not None}
    if not column.arrow or len(values) < 2:
        return []
    best = _format_cell(min(values.values(), key=_BADNESS[column.arrow]), column.form)
    return [line for line, value in values.items() if _format_cell(value, column.form) == best]


def _format_cell(value: Any, form: str) -> str:
    """Returns a value of the table as text: empty for None, the status of a verdict unchanged, else formatted by `form`."""
    if value is None or isinstance(value, VerdictStatus):
        return str(value or "")
    return form.format(value)


def write_compare(folder: Path, comparison: Comparison, summary: Mapping[str, Any]) -> None:
    """Writes every result file of a comparison except its pictures and its page into an existing folder.

    Args:
        folder: the folder.
        comparison: the finished comparison.
        summary: content of compare.json.

    Raises:
        OutputError: a file cannot be written.
    """
    recording = comparison.recording
    for row in comparison.rows:
        if row.trajectory is not None:
            _write_row(folder / row.name, row, recording)
    write_text(folder / "config.yaml", dump_yaml(comparison.settings))
    write_text(folder / "compare.csv", format_csv(summary["rows"]))
    cells, marked = tabulate(summary)
    notes = explain_table(summary, marked, "Bold")
    write_text(folder / "compare.md", format_markdown(cells, marked, notes))
    write_text(folder / "compare.tex", format_latex(cells, marked, notes))
    title = f"mqslam {summary['mqslam_version']}: comparison on {recording.path} ({recording.format})"
    ends = [summary["best"]["sentence"]] if summary["best"] else []
    write_text(folder / "run.log", format_log(title, [*list_notes(summary, recording.notes), *ends]))
    write_json(folder / "compare.json", summary)


def _write_row(folder: Path, row: Row, recording: Recording) -> None:
    """Writes the trajectory of a row, its covariances and the measurements of its front end into a new folder.

    The trajectory of a front end gets a pose for every scan. A row that is a given trajectory has no measurements.
    """
    assert row.trajectory is not None and row.odometry is not None
    folder.mkdir()
    trajectory = recording.complete(row.trajectory) if row.measurements else row.trajectory
    write_tum(folder / "trajectory.tum", trajectory)
    write_kitti(folder / "trajectory.kitti", trajectory)
    write_text(folder / "times.txt", "".join(f"{t / 1e6:.6f}\n" for t in trajectory.stamps_us.tolist()))
    if row.measurements:
        write_tum(folder / "odometry.tum", recording.complete(row.odometry))
        write_text(folder / "measurements.csv", format_measurements(row.measurements))
    if row.covariances is not None:
        write_marginals(folder / "covariances.csv", row.trajectory, row.covariances)
