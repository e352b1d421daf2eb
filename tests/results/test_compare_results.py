"""The table of a comparison: arrows in its head, its best values, and the psi that it leads with."""

from __future__ import annotations

from typing import Any

from mqslam.results.compare_results import explain_table, format_latex, format_markdown, tabulate


def summary(*rows: dict[str, Any]) -> dict[str, Any]:
    return {"rows": [{"failure": None, **row} for row in rows], "dataset": {"revolutions": 20, "compared": 13}}


def marked(*rows: dict[str, Any]) -> dict[str, list[str]]:
    """Returns the names of the rows with the best values, by column."""
    cells, best = tabulate(summary(*rows))
    return {
        head: [cells[line][0] for line in range(1, len(cells)) if (line, column) in best]
        for column, head in enumerate(cells[0])
        if column
    }


def full_row(name: str, drift: float, matched: float, **more: Any) -> dict[str, Any]:
    keys = ("drift_deg_per_100m", "ate_rmse_m", "rpe_v_rms", "odometry_drift_percent", "psi_per_point", "verdict")
    keys += (
        "psi_across_passes",
        "nees_per_degree",
        "inflation",
        "windows_torn",
        "revisit_m",
        "loops",
        "ms_per_revolution",
        "back_end_s",
    )
    return {**dict.fromkeys((*keys, "peak_rss_mb")), "name": name, "drift_percent": drift, "matched": matched, **more}


def test_the_head_says_what_is_better() -> None:
    cells, _ = tabulate(summary(full_row("a", 0.2, 0.8, loops=3, verdict="pass", psi_per_point=0.09)))
    assert cells[0] == ["", "drift [%] ↓", "matched ↑", "verdict", "loops"]


def test_the_best_value_of_a_column_is_marked() -> None:
    best = marked(full_row("a", 0.2, 0.7, loops=1), full_row("b", 0.3, 0.8, loops=2))
    assert best == {"drift [%] ↓": ["a"], "matched ↑": ["b"], "loops": []}


def test_values_that_read_the_same_are_all_marked() -> None:
    best = marked(full_row("a", 0.19701, 0.8), full_row("b", 0.19703, 0.8), full_row("c", 0.3, 0.7))
    assert best == {"drift [%] ↓": ["a", "b"], "matched ↑": ["a", "b"]}


def test_the_best_nees_is_nearest_to_one() -> None:
    rows = [full_row(name, 0.2, 0.8, nees_per_degree=nees) for name, nees in (("a", 2.1), ("b", 0.5), ("c", 0.0))]
    assert marked(*rows)["NEES/3 → 1"] == ["b"]


def test_a_value_that_stands_alone_is_not_the_best() -> None:
    assert marked(full_row("a", 0.2, 0.7)) == {"drift [%] ↓": [], "matched ↑": []}
    timed = marked(full_row("a", 0.2, 0.7, ms_per_revolution=90.0), full_row("b", 0.3, 0.8))
    assert timed["time [ms/rev] ↓"] == []


def test_a_row_that_failed_has_no_best_value() -> None:
    failed = {"name": "c", "failure": "it fell over"}
    assert marked(failed, full_row("a", 0.2, 0.7), full_row("b", 0.3, 0.8)) == {"drift [%] ↓": ["a"], "matched ↑": ["b"]}


def test_psi_across_passes_stands_in_place_of_psi_per_point() -> None:
    """The drive of the issue that asked for it, where psi per point over neighbours in time made KISS-ICP look best."""
    rows = [full_row("psi", 0.197, 0.8, psi_per_point=0.0924), full_row("kiss_icp", 0.242, 0.8, psi_per_point=0.0886)]
    assert "psi per point" not in marked(*rows)
    rows[0]["psi_across_passes"], rows[1]["psi_across_passes"] = 0.21, 0.34
    assert marked(*rows)["psi across passes ↓"] == ["psi"]


def test_the_table_is_markdown_and_latex_with_the_best_values_bold() -> None:
    rows = [full_row("my_row", 0.2, 0.8, verdict="pass"), full_row("b|c", 0.3, 0.8), {"name": "x", "failure": "50 % off"}]
    cells, best = tabulate(summary(*rows))
    lines = format_markdown(cells, best).splitlines()
    assert lines[0].startswith("|  | drift [%] ↓ | matched ↑ | verdict |") and lines[1] == "|---|---:|---:|---:|"
    assert lines[2] == "| my_row | **0.200** | **80.0%** | pass |"
    assert lines[3] == r"| b\|c | 0.300 | **80.0%** |  |" and len({line.count(" | ") for line in lines[2:]}) == 1
    assert format_markdown(cells, best, ["One.", "Two."]).splitlines()[len(lines) :] == ["", "- One.", "- Two."]
    text = format_latex(cells, best)
    assert text.startswith("\\begin{tabular}{lrr}\n\\toprule\n & my\\_row & b|c \\\\\n\\midrule\n")
    assert "drift [\\%] $\\downarrow$ & \\textbf{0.200} & 0.300 \\\\" in text
    assert text.endswith("\\bottomrule\n\\end{tabular}\n% x failed: 50 % off\n")
    assert format_latex(cells, best, ["One."]) == text + "% One.\n"


def test_notes_say_how_the_best_are_marked_which_rows_lack_scans_and_why_there_is_no_drift() -> None:
    rows = [full_row("a", 0.2, 0.7), full_row("b", 0.3, 0.8)]
    legend = "Bold is the best value; ↓ less is better, ↑ more is better, → 1 nearer to 1 is better (2 is as near as 0.5)."
    assert explain_table(summary(*rows), frozenset({(1, 1)}), "Bold") == [legend]
    assert explain_table(summary(*rows), frozenset(), "Bold") == []
    short = [row | {"scans": scans} for row, scans in zip((*rows, full_row("c", 0.4, 0.9)), (14, 20, 15), strict=True)]
    (covered,) = explain_table(summary(*short, {"name": "x", "failure": "50 % off"}), frozenset(), "Bold")
    assert covered == "Of 20 scans, a covers 14 and c covers 15; every row is judged on the 13 that all rows cover."
    gaps = [row | {"interpolated": count} for row, count in zip(rows, (0, 26), strict=True)]
    (between,) = explain_table(summary(*gaps), frozenset(), "Bold")
    assert between == "No pose lies near 26 scans of b: there the poses are interpolated between distant ones."
    unknown = [row | {"drift_percent": None, "ate_rmse_m": 0.1} for row in rows]
    (drift,) = explain_table(summary(*unknown), frozenset(), "Bold")
    assert drift == "Drift is not measured, because ground truth covers less than 100 m of the path."
