"""Derivatives of a deformed grid with respect to the displacement of its moving nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary.prescribed import given_displacement, given_gradient
from meshdeform_core.errors import GridError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.derivative import reason_of
from meshdeform_core.parallel import Part, alike, for_rows, on_each

from ..gate import checked_array
from .differentiated import differentiated
from .step import Step

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


@dataclass(frozen=True)
class Moving:
    """The moving nodes of a mesh: their unique ``numbers``, a check of arrays with a row for each, and the lock that
    calls hold."""

    numbers: IntArray
    checked: Callable[[ArrayLike, str, int], FloatArray]
    at_work: Callable[[], AbstractContextManager[None]]


class Linearisation:
    """The derivative of the grid at one displacement; made by :meth:`Mesh.linearise`.

    It is that of the method and of its repair, for a fixed undeformed grid: rotations, their smoothing and mean motions
    are differentiated as they depend on the displacement, the repair as the minimum that it is. Of a motion in several
    steps it is that of the method in one step, and :attr:`exact` is false.
    """

    def __init__(self, moving: Moving, method: PreparedMethod, step: Step, displacement: FloatArray) -> None:
        setup = step._result.setup
        self._moving, self._setup, self._step = moving, setup, step
        self._derivative, why = differentiated(step._result, method, displacement)
        self._reason = "; ".join(filter(None, (why, reason_of(self._derivative.kinks))))

    @property
    def step(self) -> Step:
        """The deformed grid at this displacement, as :meth:`Mesh.deform` gives it."""
        return self._step

    @property
    def exact(self) -> bool:
        """Whether this is the derivative of :attr:`step`; else :attr:`reason` says why not."""
        return not self._reason

    @property
    def reason(self) -> str:
        """Why the derivative is not that of :attr:`step`; empty if it is."""
        return self._reason

    def jvp(self, displacement: ArrayLike) -> list[FloatArray]:
        """Change of the blocks' coordinates, arrays like ``mesh.grid.blocks``, for a change of the displacement.

        If every rank holds a part of the grid: arrays like ``mesh.grid.part``; all ranks call this, with the same
        change.

        Parameters
        ----------
        displacement : (n_moving, 3) change of the displacement, rows as in :attr:`Mesh.points`

        Raises
        ------
        MotionError
            For an array of another shape, values that are not finite, or a change out of the plane of a 2-D grid.
        """
        with self._moving.at_work():
            change = self._moving.checked(displacement, "displacement", len(self._moving.numbers))
            return self._step.grid._parted(self._pushed(change))

    def vjp(self, gradients: Sequence[ArrayLike]) -> FloatArray:
        """Gradient (n_moving, 3) with respect to the displacement from that with respect to the coordinates.

        The transpose of :meth:`jvp`. The contributions of coincident block nodes are added.

        Parameters
        ----------
        gradients : one array per block, like ``mesh.grid.blocks``; if every rank holds a part of the grid, of the nodes
            in its ``mesh.grid.part``. All ranks call this together and get the whole gradient

        Raises
        ------
        GridError
            When their number or shapes are not those of the blocks, or values are not finite.
        """
        with self._moving.at_work():
            return self._pulled(self._flat(gradients))

    @property
    def operator(self) -> LinearOperator:
        """The derivative as a scipy ``LinearOperator`` of shape (3 n_nodes, 3 n_moving), with its transpose.

        Rows: nodes of all blocks in block order, C order within a block, x y z last; columns: rows of ``mesh.points``.

        Raises
        ------
        GridError
            When every rank holds a part of the grid; use :meth:`jvp` and :meth:`vjp`.
        """
        from scipy.sparse.linalg import LinearOperator

        self._step.grid._whole("a linear operator")
        nodes, moving = self._setup.grid.n_nodes, len(self._moving.numbers)

        def push(x: FloatArray) -> FloatArray:
            with self._moving.at_work():
                return self._pushed(_real(x).reshape(moving, 3)).ravel()

        def pull(w: FloatArray) -> FloatArray:
            with self._moving.at_work():
                return self._pulled(_real(w).reshape(nodes, 3)).ravel()

        return LinearOperator((3 * nodes, 3 * moving), matvec=push, rmatvec=pull, dtype=np.float64)

    def _pushed(self, change: FloatArray) -> FloatArray:
        setup = self._setup
        total = given_displacement(setup.grid, setup.topology, setup.boundary, self._moving.numbers, change)
        return self._derivative.push(total[setup.problem.source_numbers])

    def _pulled(self, gradient: FloatArray) -> FloatArray:
        """:meth:`vjp` of a gradient (n_nodes, 3), which is overwritten."""
        setup = self._setup
        total = np.zeros((setup.topology.n_unique, 3))
        total[setup.problem.source_numbers] = self._derivative.pull(gradient)
        return given_gradient(setup.grid, setup.boundary, self._moving.numbers, total)

    def _flat(self, gradients: Sequence[Any]) -> FloatArray:
        """Gradients of the parts of the grid as one array (n_nodes, 3), in parts if the grid is."""
        parts = self._step.grid.part
        flat = alike(self._setup.grid.points)
        for_rows(lambda rows: flat[rows].fill(0.0), flat)

        def fill() -> None:
            found = list(gradients) if isinstance(gradients, Iterable) else [gradients]
            if len(found) != len(parts):
                raise GridError(f"found gradients for {len(found)} blocks; expected those of the {len(parts)} blocks")
            for (block, _, _, points), each in zip(parts, found, strict=True):
                what, meaning = f"gradient of block {block + 1}", f"expected those of the {len(parts)} blocks"
                values = checked_array(each, points.shape, what, meaning, GridError)
                self._step.grid._rows(block, flat)[...] = values

        if isinstance(flat, Part):
            on_each(flat, fill)
        else:
            fill()
        return flat


def _real(values: Any) -> FloatArray:
    """The argument of a ``LinearOperator`` as a new real array."""
    found = np.array(values)
    if found.dtype.kind == "c":
        raise GridError("found complex numbers; expected real ones: apply the operator to both parts")
    return found.astype(np.float64)
