"""Audits of whole maps under several trajectories: a row each."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Column, Row, label
from bench.measuring.commands import audit

COLUMNS = (
    label("data", "recording"),
    label("trajectory", "trajectory"),
    Column("verdict", "verdict", "{}"),
    Column("torn", "windows torn", "{:.1%}"),
    Column("inflation", "median inflation", "{:.1f}"),
    Column("revisits", "revisits", "{:.0f}"),
    Column("revisits_torn", "torn", "{:.0f}"),
    Column("apart_m", "median apart [m]", "{:.3f}"),
)


def measure_audit(name: str, data: Path, shown: str, trajectory: Path | str, out: Path) -> Row:
    """Returns the row of an audit.

    Args:
        name, shown: of the recording and the trajectory, as the table shows them.
        data: the recording.
        trajectory: a file, or one that the recording carries.
        out: folder for the results.
    """
    judged = audit(data, trajectory, out)
    windows, revisits = judged["windows"], judged["revisits"]
    return Row(
        {
            "data": name,
            "trajectory": shown,
            "verdict": judged["verdict"]["status"],
            "torn": windows["torn"] / windows["count"],
            "inflation": windows["inflation_median"],
            "revisits": revisits["sure"],
            "revisits_torn": revisits["torn"],
            "apart_m": revisits["median_m"],
        },
        judged=False,
    )
