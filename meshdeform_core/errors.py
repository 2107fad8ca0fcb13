"""Errors a user can act on. Each message says what was found, what was expected, where, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def suggestion(word: object, known: Iterable[str], most: int = 1) -> str:
    """A "did you mean" clause for an unknown word; empty if no known word is similar."""
    close = difflib.get_close_matches(str(word), list(known), most)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""


class MeshDeformError(Exception):
    """Base of all errors caused by the input rather than the program (exit code 2)."""


class GridError(MeshDeformError):
    """The grid itself cannot be used: impossible shapes, NaN coordinates, mixed dimensions."""


class FormatError(MeshDeformError):
    """A file cannot be read as expected: unknown format, truncated, ambiguous, not block-structured."""


class CaseError(MeshDeformError):
    """The case asks for something that does not exist: unknown keys, empty selections."""


class MotionError(MeshDeformError):
    """The prescribed motion cannot be imposed: conflicting values, nothing moves, unmatched points."""


class MethodError(MeshDeformError):
    """The deformation method cannot be used: unknown name, parameter out of range, not enough memory."""
