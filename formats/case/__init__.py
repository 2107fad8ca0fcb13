"""Case files."""

from .reader import CaseFile, case_of, read_case

__all__ = ["CaseFile", "case_of", "read_case"]
