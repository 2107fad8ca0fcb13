"""The result of one deformation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from meshdeform_core.deform import Result
from meshdeform_core.errors import GridError
from meshdeform_core.grid import FloatArray
from meshdeform_core.memory import peak_memory
from meshdeform_core.quality import InvalidCell
from meshdeform_core.repair.outcome import Repair

from ..grids.grid import Grid
from ..notebook import html_table, quality_rows


class QualityGradient(NamedTuple):
    """A quality measure and its gradient, one array per block like ``step.grid.blocks``."""

    value: float
    blocks: list[FloatArray]


class Step:
    """A deformed grid and the verdict on it; made by :meth:`Mesh.deform` and :func:`meshdeform.deform`."""

    def __init__(self, result: Result, plane: bool):
        self._result, self._plane = result, plane

    @property
    def valid(self) -> bool:
        """Whether the whole displacement was imposed and no cell became invalid."""
        return self._result.valid

    @cached_property
    def grid(self) -> Grid:
        """The deformed grid, with all data that came with the undeformed one."""
        return Grid._of(self._result.grid, self._plane)

    @property
    def invalid_cells(self) -> tuple[InvalidCell, ...]:
        """Cells that were valid and no longer are: block, i, j, k (from 1), position, nearest patch."""
        return self._result.assessment.invalid

    def swept_volumes(self, previous: Step | Grid) -> list[tuple[FloatArray, ...]]:
        """Volumes that the cell faces sweep on straight paths from the grid of another step, or the undeformed one.

        For each block one array per index axis, of the faces across it: (ni, nj - 1, nk - 1), (ni - 1, nj, nk - 1) and
        (ni - 1, nj - 1, nk); in 2-D areas, (ni, nj - 1) and (ni - 1, nj). Positive towards the larger index: up to
        round-off, the volume of each cell (positive if valid) changes by the volumes swept by its far faces minus those
        swept by its near faces. Divided by the time between the two steps, they are the volume fluxes of the faces for
        a solver with first-order backward differences.

        Raises
        ------
        GridError
            When the two have different blocks.
        """
        from meshdeform_core.quality.difference import require_same_blocks
        from meshdeform_core.velocity import at_faces, swept_volumes

        grid, before = self.grid._whole("swept volumes"), previous.grid if isinstance(previous, Step) else previous
        if not isinstance(before, Grid):
            raise GridError(f"previous is a {type(before).__name__}; expected a step or a grid")
        earlier = before._whole("swept volumes")
        require_same_blocks(grid, earlier)
        undeformed = self._result.setup.grid
        found = at_faces(undeformed, swept_volumes(undeformed, earlier.points, grid.points))
        return [
            tuple(np.squeeze(part, axis=shape.index(1)) if 1 in shape else part for part in faces if part.size)
            for shape, faces in zip(undeformed.shapes, found, strict=True)
        ]

    def quality_gradient(
        self, measure: str, sharpness: float = 100.0, blocks: Sequence[int] | None = None
    ) -> QualityGradient:
        """A quality measure of the grid with its gradient with respect to the coordinates, for optimisers.

        :meth:`Linearisation.vjp` of the gradient is the gradient with respect to the displacement.

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
        from meshdeform_core.quality.measures.gradients import quality_gradient

        grid, setup = self.grid._whole("a gradient"), self._result.setup
        value, gradient = quality_gradient(grid, grid.points, setup.topology, measure, sharpness, blocks)
        found = [grid.block(b, gradient) for b in range(grid.n_blocks)]
        return QualityGradient(value, [block[:, :, 0, :2].copy() if self._plane else block for block in found])

    @property
    def steps(self) -> int:
        """Number of increments in which the displacement was imposed."""
        return self._result.steps

    @property
    def repair(self) -> Repair | None:
        """Summary of the repairs made: cells, nodes, largest movement; ``None`` if nothing was repaired."""
        return self._result.repair

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings about this deformation."""
        return self._result.warnings

    @cached_property
    def report(self) -> dict[str, Any]:
        """The report of the command line as a dictionary (see docs/report.md): quality, verdict, parameters, times."""
        from meshdeform_formats.report import deformation_report

        seconds = self._result.timing.seconds
        return deformation_report(self._result, {"total": sum(seconds.values())}, peak_memory())

    def __repr__(self) -> str:
        invalid = self._result.assessment.after.invalid_cells
        verdict = "valid" if self.valid else f"INVALID: {invalid:,} cells"
        if self._result.reached < 1.0:
            verdict += f", {self._result.reached:.1%} imposed"
        count = f"{self.steps} {'step' if self.steps == 1 else 'steps'}"
        return f"Step({verdict}; {count}, largest displacement {self._result.max_displacement:.6g})"

    def _repr_html_(self) -> str:
        return html_table(repr(self), quality_rows(asdict(self._result.assessment.after)))
