"""Errors a user can act on. Each message says what was found, what was expected, where, and what to do."""


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
