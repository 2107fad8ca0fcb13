"""Reports: contents and file formats."""

from .parts import Report, with_other
from .records import deformation_report, mended_report, plan_report, quality_report
from .run import run_part
from .write import as_json, check_report_path, write_report

__all__ = [
    "Report",
    "as_json",
    "check_report_path",
    "deformation_report",
    "mended_report",
    "plan_report",
    "quality_report",
    "run_part",
    "with_other",
    "write_report",
]
