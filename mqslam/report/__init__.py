"""The report of a run: one self-contained HTML page."""

from __future__ import annotations

from mqslam.report.content import Report, WindowScores
from mqslam.report.html import write_report

__all__ = ["Report", "WindowScores", "write_report"]
