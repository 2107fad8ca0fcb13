"""Reports: contents and file formats."""

from .figures import Figure, Illustrate, Illustrations
from .records import (
    Report,
    deformation_report,
    head_part,
    level_record,
    mended_report,
    plan_report,
    quality_report,
    series_head,
    series_report,
    with_other,
)
from .write import as_json, check_report_path, run_part, write_report

__all__ = [
    "Figure",
    "Illustrate",
    "Illustrations",
    "Report",
    "as_json",
    "check_report_path",
    "deformation_report",
    "head_part",
    "level_record",
    "mended_report",
    "plan_report",
    "quality_report",
    "run_part",
    "series_head",
    "series_report",
    "with_other",
    "write_report",
]
