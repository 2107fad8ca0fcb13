"""Errors a user can act on. Each message says what was found, what was expected, where, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def suggestion(word: object, known: Iterable[str], most: int = 1) -> str:
    """The end of a message about an unknown word: the known ones nearest to it; empty if none is near."""
    close = difflib.get_close_matches(str(word), list(known), most)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""


class MeshDeformError(Exception):
    """Base of all errors that are the input's fault, not the program's (exit code 2)."""


class GridError(MeshDeformError):
    """The grid itself cannot be used: impossible shapes, NaN coordinates, mixed dimensions."""


class FormatError(MeshDeformError):
    """A file is not what it should be: unknown, truncated, ambiguous, not block-structured."""


class CaseError(MeshDeformError):
    """The case asks for something that does not exist: unknown keys, empty selections."""


class MotionError(MeshDeformError):
    """The prescribed motion cannot be imposed: conflicts, nothing moves, unmatched points."""


class MethodError(MeshDeformError):
    """The deformation method cannot do what is asked: unknown name, parameter out of range."""
