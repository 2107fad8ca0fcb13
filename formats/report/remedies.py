"""Advice on warnings that do not contain it themselves."""

from __future__ import annotations

_REMEDIES = (
    (
        "not selected by any boundary entry; they are fixed",
        "If some of them are planes on which nodes should slide, add a boundary entry for them with "
        'kind = "slip" or "symmetry"; if they are the far field, no action is needed.',
    ),
    (
        "the grid is one cell thick",
        "No action is needed if this is a two-dimensional case; otherwise add a boundary entry for the end planes.",
    ),
    (
        "nothing moves",
        "Check the motion in the case: a formula that is zero at this time (--time), a table with zero "
        "displacements, or an angle of 0.",
    ),
    (
        "of the motion was imposed; a further step",
        "The report's invalid cells are those of the next step. Another method, a slip plane instead of a fixed one, "
        "or more space beside the wall allows a larger motion.",
    ),
    (
        "out of a slip or symmetry plane",
        "Give the plane itself a motion, or check the axis and the components of the motion.",
    ),
    (
        "face quads are shared by more than two blocks",
        "Such faces cannot be interfaces; check the grid generator's export for duplicate blocks.",
    ),
    (
        "node pairs do not coincide",
        "If the gap is round-off of the file, raise grid.tolerance (a fraction of the local edge); otherwise the "
        "connection in the file is wrong.",
    ),
    (
        "but no connection declares them",
        "No action is needed if the blocks belong together. For a thin plate whose two sides coincide, name one "
        "side in the case: [grid] plates.",
    ),
)


def remedy_of(warning: str) -> str:
    """Advice for a warning; empty if the warning itself contains it."""
    return next((advice for words, advice in _REMEDIES if words in warning), "")
