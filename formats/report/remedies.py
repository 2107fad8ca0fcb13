"""What to do about warnings that do not say so themselves."""

from __future__ import annotations

_REMEDIES = (
    (
        "selected by no boundary entry; they are fixed",
        "If some of them are planes on which nodes should slide, add a boundary entry for them with "
        'kind = "slip" or "symmetry"; if they are the far field, nothing is to be done.',
    ),
    (
        "the grid is one cell thick",
        "Nothing is to be done if that is a two-dimensional case; otherwise give the end planes an entry of their own.",
    ),
    (
        "nothing moves",
        "Look at the motion in the case: a formula that is zero at this time (--time), a table with zero "
        "displacements, or an angle of 0.",
    ),
    (
        "the motion was imposed to",
        "The report's invalid cells are those of the next step. Another method, a slip plane instead of a fixed one, "
        "or more room beside the wall lets the motion go further.",
    ),
    (
        "out of a slip or symmetry plane",
        "Make the plane's own entry move with the body, or check the axis and the components of the motion.",
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
        "Nothing is to be done if the blocks belong together. For a thin plate with two sides on one place, give each "
        "side its own boundary entry in the file or in a neutral map file.",
    ),
)


def remedy_of(warning: str) -> str:
    """Advice for a warning; empty where its own text has it."""
    return next((advice for words, advice in _REMEDIES if words in warning), "")
