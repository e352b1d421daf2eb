"""The reports of runs, audits and comparisons: one self-contained HTML page each."""

from __future__ import annotations

from mqslam.report.audit_page import AuditReport, heat_map, write_audit_report
from mqslam.report.compare_page import CompareReport, overlay, write_compare_report
from mqslam.report.content import Report, WindowScores
from mqslam.report.run_page import write_report

__all__ = [
    "AuditReport",
    "CompareReport",
    "Report",
    "WindowScores",
    "heat_map",
    "overlay",
    "write_audit_report",
    "write_compare_report",
    "write_report",
]
