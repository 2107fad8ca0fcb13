"""The result of one deformation, and the derivative of the grid there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from meshdeform_core.deform import Result
from meshdeform_core.errors import GridError
from meshdeform_core.grid import FloatArray
from meshdeform_core.memory import peak_memory
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.base import Linearised
from meshdeform_core.overset import PreparedComponents
from meshdeform_core.parallel import Nodes
from meshdeform_core.quality import InvalidCell
from meshdeform_core.repair.derivative import derivative_of_repair
from meshdeform_core.repair.outcome import Repair
from meshdeform_core.wording import counted

from .grid import Grid, by_part, together, whole, wrapped

_CLOSE = 1e-4
"""A repaired grid farther from the minimum than this fraction of the shortest edge, round-off aside, is not at it."""


class QualityGradient(NamedTuple):
    """A quality measure and its gradient, one array per block like ``step.grid.blocks``, or per ``step.grid.part``."""

    value: float
    blocks: list[FloatArray]


class Step:
    """A deformed grid and the verdict on it; made by :meth:`Mesh.deform` and :func:`meshdeform.deform`."""

    def __init__(self, result: Result, plane: bool):
        self.result, self._plane = result, plane

    @property
    def valid(self) -> bool:
        """Whether the whole displacement was imposed and no cell became invalid."""
        return self.result.valid

    @cached_property
    def grid(self) -> Grid:
        """The deformed grid, with all data that came with the undeformed one."""
        return wrapped(self.result.grid, self._plane)

    @property
    def invalid_cells(self) -> tuple[InvalidCell, ...]:
        """Cells that were valid and no longer are: block, i, j, k (from 1), position, nearest patch."""
        return self.result.assessment.invalid

    def swept_volumes(self, previous: Step | Grid) -> list[tuple[FloatArray, ...]]:
        """Volumes that the cell faces sweep on straight paths from the grid of another step, or the undeformed one.

        For each block one array per index axis, of the faces across it: (ni, nj - 1, nk - 1), (ni - 1, nj, nk - 1) and
        (ni - 1, nj - 1, nk); in 2-D areas, (ni, nj - 1) and (ni - 1, nj). If every rank holds a part of the grids, one
        tuple for each ``grid.part``, with the faces on and behind its planes. Positive towards the larger index: up to
        round-off, the volume of each cell (positive if valid) changes by the volumes swept by its far faces minus those
        swept by its near faces. Divided by the time between the two steps, they are the volume fluxes of the faces for
        a solver with first-order backward differences.

        Raises
        ------
        GridError
            When the two have different blocks, or only one of them is in parts.
        """
        from meshdeform_core.quality.difference import require_same_blocks
        from meshdeform_core.velocity import swept_volumes

        grid, before = self.grid, previous.grid if isinstance(previous, Step) else previous
        if not isinstance(before, Grid):
            raise GridError(f"previous is a {type(before).__name__}; expected a step or a grid")
        require_same_blocks(grid.core, before.core)
        if list(grid.core.nodes.bounds) != list(before.core.nodes.bounds):
            for each in (grid, before):
                whole(each, "swept volumes from a grid that is not divided likewise")
        undeformed = self.result.setup.grid
        with together(grid):
            found = swept_volumes(undeformed, before.core.points, grid.core.points)
        swept = []
        for part in grid.part:
            shape = undeformed.shapes[part.block]
            # In 2-D without the axis that has a single node.
            faces = [each for each, count in zip(found[part.block], shape, strict=True) if count > 1]
            swept.append(tuple(np.squeeze(each, axis=shape.index(1)) if 1 in shape else each for each in faces))
        return swept

    def quality_gradient(
        self, measure: str, sharpness: float = 100.0, blocks: Sequence[int] | None = None
    ) -> QualityGradient:
        """A quality measure of the grid with its gradient with respect to the coordinates, for optimisers.

        :meth:`Linearisation.vjp` of the gradient is the gradient with respect to the displacement. If every rank holds
        a part of the grid, all ranks call this together; they get the same value, and the gradient for each
        ``grid.part``.

        Parameters
        ----------
        measure : ``f_skew`` (harmonic mean over the cells), ``f_skew_min`` and ``scaled_jacobian_min`` (smooth lower
            bounds of the smallest f_skew of a cell and scaled Jacobian of a corner), ``volume`` (in 2-D area)
        sharpness : of the smooth minima: they are too low by at most log(number of values) / sharpness
        blocks : numbers of blocks from 0, to measure their cells only: the volume of a tank, for instance

        Raises
        ------
        GridError
            For an unknown measure or block, and for f_skew of a grid with invalid cells, where it is zero without a
                gradient.
        """
        from meshdeform_core.quality.gradients import quality_gradient

        grid, topology = self.grid, self.result.setup.topology
        with together(grid):
            core = grid.core
            value, gradient = quality_gradient(core, core.points, topology, measure, sharpness, blocks)
        return QualityGradient(value, by_part(grid, gradient))

    @property
    def steps(self) -> int:
        """Number of increments in which the displacement was imposed."""
        return self.result.steps

    @property
    def repair(self) -> Repair | None:
        """Summary of the repairs made: cells, nodes, largest movement; ``None`` if nothing was repaired."""
        return self.result.repair

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings about this deformation."""
        return self.result.warnings

    @cached_property
    def report(self) -> dict[str, Any]:
        """The report of the command line as a dictionary (see docs/report.md): quality, verdict, parameters, times."""
        from meshdeform_formats.report.records import deformation_report

        seconds = self.result.timing.seconds
        return deformation_report(self.result, {"total": sum(seconds.values())}, peak_memory())

    def __repr__(self) -> str:
        invalid = self.result.assessment.after.invalid_cells
        verdict = "valid" if self.valid else f"INVALID: {invalid:,} cells"
        if self.result.reached < 1.0:
            verdict += f", {self.result.reached:.1%} imposed"
        return (
            f"Step({verdict}; {counted(self.steps, 'step')}, largest displacement {self.result.max_displacement:.6g})"
        )


def unusable(step: Step) -> str:
    """A message on an invalid grid, for programs that cannot go on with it."""
    first = step.invalid_cells[0] if step.invalid_cells else "none is invalid"
    return f"the deformed grid cannot be used: {step!r}; first cell: {first}"


def differentiated(result: Result, method: PreparedMethod, displacement: FloatArray) -> tuple[Linearised, str]:
    """The derivative of a deformed grid, and the reason why it does not hold for this grid; empty if it does.

    ``method`` is prepared on the undeformed grid, and ``displacement`` (n_sources, 3) that of its sources. The
    components of an overset grid have derivatives of their own.
    """
    if isinstance(method, PreparedComponents):
        return method.differentiated(result, displacement, differentiated)
    derivative = method.linearised(displacement)
    if result.steps > 1 and result.reached == 1.0:
        return derivative, f"the motion was imposed in {result.steps} steps; the derivative is that of one step"
    points = result.setup.grid.nodes.combined(np.add, method.apply(displacement))
    if _largest_magnitude(Nodes.of(points).combined(np.subtract, result.grid.points)) <= _rounding(result):
        return derivative, ""
    if result.reached < 1.0:
        part = f"only {result.reached:.1%} of the motion was imposed"
        return derivative, f"{part}; the derivative is that of the method for all of it"
    if result.repair is None:
        return derivative, "another method replaced the chosen one; the derivative is that of the chosen one"
    setup, repair, why = result.setup, None, "but is not the minimum of the repair's energy"
    if Nodes.of(points).divided:
        why = "in parts, and the derivative of that takes the whole grid on every rank"
    elif result.repair.converged:
        polish = setup.case.repair.mode == "polish"
        repair = derivative_of_repair(setup.undeformed.repairs, points, result.grid.points, polish)
    if repair is None or repair.settle(_rounding(result)) > _CLOSE:
        return derivative, f"the grid was repaired, {why}; the derivative is that of the method before the repair"
    return Linearised(
        lambda change: repair.push(derivative.push(change)),
        lambda gradient: derivative.pull(repair.pull(gradient)),
        derivative.kinks,
    ), ""


def _rounding(result: Result) -> float:
    """Largest difference between the coordinates of the result and those before rounding."""
    return 4.0 * float(np.finfo(result.setup.grid.precision).eps) * _largest_magnitude(result.setup.grid.points)


def _largest_magnitude(values: FloatArray) -> float:
    """Largest magnitude of ``values`` (n_nodes, 3), of all ranks if they are in parts."""
    nodes = Nodes.of(values)
    return max(nodes.gather(max(float(nodes.own.max(initial=0.0)), -float(nodes.own.min(initial=0.0)))))
