"""The pages of runs, audits, comparisons and batches: one self-contained HTML file each."""

from __future__ import annotations

from mqslam.report.audit_page import write_audit_report
from mqslam.report.compare_page import write_compare_report
from mqslam.report.inputs.audit_report import AuditReport
from mqslam.report.inputs.compare_report import CompareReport
from mqslam.report.inputs.run_report import Report, ScanScores
from mqslam.report.run_page import write_report

__all__ = [
    "AuditReport",
    "CompareReport",
    "Report",
    "ScanScores",
    "write_audit_report",
    "write_compare_report",
    "write_report",
]
