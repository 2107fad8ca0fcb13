"""The judgement of a grid that another program deformed, or of a grid on its own."""

from __future__ import annotations

from .boundary import classify
from .boundary.classification import with_plates
from .deform import Case
from .grid import Grid
from .grid.components import with_components
from .grid.topology import find_topology
from .quality import Assessment, Original, assess
from .quality.difference import require_same_blocks


def judge_grid(grid: Grid, original: Grid, case: Case) -> tuple[Assessment, tuple[str, ...]]:
    """Judge ``grid`` against ``original``, which may be the same; the case defines the moving walls.

    Returns the assessment and the warnings about the original.

    Raises
    ------
    GridError
        When the two have different blocks.
    """
    require_same_blocks(grid, original)
    original = with_components(original, case.components)
    original, topology = with_plates(original, find_topology(original, case.tolerance), case.plates)
    boundary = None
    notes = original.notes
    if case.boundaries:
        boundary = classify(original, topology, case.boundaries, case.constants)
        notes += boundary.notes
    return assess(Original(original, topology), grid.points, boundary), notes
