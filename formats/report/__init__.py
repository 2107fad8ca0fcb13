"""Reports: what they hold, and how they are written."""

from .parts import Report
from .records import deformation_report, plan_report, quality_report
from .write import check_report_path, write_report

__all__ = ["Report", "check_report_path", "deformation_report", "plan_report", "quality_report", "write_report"]
