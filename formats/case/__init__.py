"""Case files."""

from .reader import CaseFile, read_case

__all__ = ["CaseFile", "read_case"]
