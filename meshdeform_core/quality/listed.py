"""Cells listed in reports: invalid and worst cells with their locations; those that the boundary alone inverts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..boundary import Boundary, Kind
from ..grid import FloatArray, Grid, IntArray, Shape
from ..grid.topology import Topology, cells_behind
from ..numerics.cell.measures import measure_cells
from ..wording import Notice, counted
from .cells import corner_nodes, corners_of, places
from .original import Original
from .validity import Failure, Verdict, relative_jacobian


@dataclass(frozen=True)
class Worst:
    """The cell with the worst value of a measure; ``ijk`` are 1-based, ``center`` is the mean of the corners."""

    value: float
    block: str
    ijk: Shape
    center: tuple[float, float, float]


@dataclass(frozen=True)
class InvalidCell:
    """A cell that was valid and no longer is.

    ``test`` is the test that it failed, see :class:`.validity.Failure`; ``ijk`` are 1-based; ``center`` is
    the mean of the corners; ``step`` is the first step after which it was invalid.
    """

    block: str
    ijk: Shape
    f_skew: float
    min_jacobian: float
    center: tuple[float, float, float]
    test: str = ""
    nearest_patch: str = ""
    step: int = 1


def worst_cell(grid: Grid, points: FloatArray, cell: int, value: float) -> Worst:
    """The entry for ``cell``, the number of the cell with the worst value of a measure; an infinite value becomes 1."""
    number = np.array([cell])
    (block,), ijk = places(grid, number)
    i, j, k = (ijk[0] + 1).tolist()
    x, y, z = corners_of(grid, points, number)[0].mean(axis=0).tolist()
    return Worst(value if np.isfinite(value) else 1.0, grid.names[block], (i, j, k), (x, y, z))


def list_cells(
    original: Original,
    boundary: Boundary | None,
    points: FloatArray,
    cells: IntArray,
    verdict: Verdict,
    step_of: Callable[[int], int],
) -> tuple[InvalidCell, ...]:
    """Entries for ``cells`` (numbers of invalid cells) at coordinates ``points`` (n_nodes, 3), with the boundary
    nearest to each in the undeformed grid, see :func:`nearest_patches`, and the step."""
    if not cells.size:
        return ()
    grid, (block, ijk) = original.grid, places(original.grid, cells)
    x, before = (corners_of(grid, each, cells) for each in (points, grid.points))
    found = measure_cells(x, original.sides(block))
    rows = zip(
        (grid.names[b] for b in block), map(tuple, (ijk + 1).tolist()), found.skew.tolist(),
        found.jacobian.min(axis=1).tolist(), map(tuple, x.mean(axis=1).tolist()),
        (Failure(failed).label for failed in verdict.failed[cells]),
        nearest_patches(grid, original.topology, boundary, before.mean(axis=1)), map(step_of, cells.tolist()),
        strict=True,
    )  # fmt: skip
    return tuple(InvalidCell(*row) for row in rows)


def find_pinned(original: Original, boundary: Boundary, displacement: FloatArray) -> Notice | None:
    """Warning about cells with only prescribed nodes that a displacement (n_unique, 3) of the boundary inverts: the
    Jacobian at a corner that was not collapsed is no longer positive."""
    grid, topology = original.grid, original.topology
    # Cells all of whose nodes are on block faces lie in blocks one cell across, and have a face with all nodes known.
    quads = np.flatnonzero(boundary.known[topology.quads.corners].all(axis=1))
    block, ijk = places(grid, np.unique(cells_behind(grid, topology, quads)))
    nodes = corner_nodes(grid, block, ijk)
    number = topology.numbers_of(nodes)
    chosen = np.flatnonzero(((number >= 0) & boundary.known[number]).all(axis=1))
    before = grid.nodes.at(nodes[chosen])
    after = before + displacement[number[chosen]]
    old, new = (measure_cells(x, original.sides(block[chosen])).jacobian for x in (before, after))
    bad = np.flatnonzero(relative_jacobian(old, new) <= 0.0)
    if not bad.size:
        return None
    first, name = chosen[bad[0]], grid.names[block[chosen[bad[0]]]]
    i, j, k = (ijk[first] + 1).tolist()
    around = ", ".join(f"{x:.6g}" for x in after[bad[0]].mean(axis=0))
    only = "whose nodes are all prescribed"
    return Notice(
        f"{counted(bad.size, f'cell, {only}, is', f'cells, {only}, are')} inverted by the motion of the boundary "
        f"itself, so no valid grid exists: first in {name} at ({i}, {j}, {k}), around ({around})",
        f"prescribed cells inverted in {name}",
    )


def nearest_patches(grid: Grid, topology: Topology, boundary: Boundary | None, at: FloatArray) -> list[str]:
    """Names of the moving boundaries nearest to points (n, 3), or of any boundaries if none moves; empty without any.

    Fixed boundaries are left out because in grids of few layers the side planes would be nearest everywhere.
    """
    if boundary is None or not boundary.patches:
        return [""] * len(at)
    patches = [patch for patch in boundary.patches if patch.kind is Kind.MOVING] or list(boundary.patches)
    nodes = [grid.nodes.at(topology.first[patch.nodes]) for patch in patches]
    distance = np.array([[((each - x) ** 2).sum(axis=1).min(initial=np.inf) for x in at] for each in nodes])
    return [patches[int(n)].name for n in distance.argmin(axis=0)]
