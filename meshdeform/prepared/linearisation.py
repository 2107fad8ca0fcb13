"""Derivatives of a deformed grid with respect to the displacement of its moving nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary.prescribed import given_displacement, given_gradient
from meshdeform_core.deform import Result
from meshdeform_core.errors import GridError, MethodError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.connectivity.components import Component
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.derivative import (
    ComponentsInSteps,
    StepsDerivative,
    derivative_of,
    derivative_of_steps,
    reason_of,
)
from meshdeform_core.repair.derivative import ComponentRepairs, RepairDerivative, derivative_of_repair

from ..gate import checked_array
from .step import Step

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


_CLOSE = 1e-4
"""Of shortest edges: a repaired grid farther from the minimum than that, round-off aside, was found otherwise."""


@dataclass(frozen=True)
class Moving:
    """The moving nodes of a mesh: their unique ``numbers``, the check of arrays like them, and how calls take turns."""

    numbers: IntArray
    checked: Callable[[ArrayLike, str, int], FloatArray]
    at_work: Callable[[], AbstractContextManager[None]]


class Linearisation:
    """The derivative of the grid at one displacement; made by :meth:`Mesh.linearise`.

    It is that of the method and of its repair, for a fixed undeformed grid: rotations, their smoothing and mean motions
    are differentiated as they depend on the displacement, the repair as the minimum that it is; several steps by the
    chain rule, each with the derivative with respect to the grid from which it starts.
    """

    def __init__(self, moving: Moving, method: PreparedMethod, step: Step, displacement: FloatArray) -> None:
        setup = step._result.setup
        self._moving, self._setup, self._step = moving, setup, step
        chain, why = _chained(method, step, displacement) if step.steps > 1 else (None, "")
        self._derivative = chain or derivative_of(method, displacement)
        plain = chain.points if chain else setup.grid.points + method.apply(displacement)
        self._repair, self._reason = _difference(plain, step, why)
        self._reason = "; ".join(filter(None, (self._reason, reason_of(self._derivative.kinks))))

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
        """Change of the blocks' coordinates, arrays like ``mesh.grid.blocks``, for one of the moving nodes.

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
            return self._blocks(self._pushed(change))

    def vjp(self, gradients: Sequence[ArrayLike]) -> FloatArray:
        """Gradient (n_moving, 3) with respect to the displacement from that with respect to the coordinates.

        The transpose of :meth:`jvp`. Block nodes that stand for one point each add their part.

        Parameters
        ----------
        gradients : one array per block, like ``mesh.grid.blocks``

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
        """
        from scipy.sparse.linalg import LinearOperator

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
        moved = self._derivative.push(total[setup.problem.source_numbers])
        return self._repair.push(moved) if self._repair else moved

    def _pulled(self, gradient: FloatArray) -> FloatArray:
        """From the gradient (n_nodes, 3), which is overwritten."""
        setup = self._setup
        if self._repair:
            gradient = self._repair.pull(gradient)
        total = np.zeros((setup.topology.n_unique, 3))
        total[setup.problem.source_numbers] = self._derivative.pull(gradient)
        return given_gradient(setup.grid, setup.boundary, self._moving.numbers, total)

    def _blocks(self, values: FloatArray) -> list[FloatArray]:
        grid = self._setup.grid
        blocks = [grid.block(b, values) for b in range(grid.n_blocks)]
        return [block[:, :, 0, :2].copy() if self._step._plane else block for block in blocks]

    def _flat(self, gradients: Sequence[Any]) -> FloatArray:
        grid, shapes = self._setup.grid, [block.shape for block in self._step.grid.blocks]
        found = list(gradients) if isinstance(gradients, Iterable) else [gradients]
        if len(found) != len(shapes):
            raise GridError(f"found gradients for {len(found)} blocks; expected those of the {len(shapes)} blocks")
        flat = np.zeros((grid.n_nodes, 3))
        for block, (each, shape) in enumerate(zip(found, shapes, strict=True)):
            what, meaning = f"gradient of block {block + 1}", f"expected those of the {len(shapes)} blocks"
            rows = flat[grid.offsets[block] : grid.offsets[block + 1]]
            rows[:, : shape[-1]] = checked_array(each, shape, what, meaning, GridError).reshape(-1, shape[-1])
        return flat


def _real(values: Any) -> FloatArray:
    """A copy of the argument of a ``LinearOperator``."""
    found = np.array(values)
    if found.dtype.kind == "c":
        raise GridError("found complex numbers; expected real ones: apply the operator to both parts")
    return found.astype(np.float64)


def _chained(
    method: PreparedMethod, step: Step, displacement: FloatArray
) -> tuple[StepsDerivative | ComponentsInSteps | None, str]:
    """The derivative of the steps that led to a grid, or why there is none."""
    result = step._result
    # The attempt made last for each step is the one that was accepted.
    fractions = {attempt.steps: attempt.reached for attempt in result.attempts}
    if result.reached < 1.0 or result.repair is not None:
        return None, "with a repair on the way"
    case, problem = result.setup.case, result.setup.problem
    try:
        ends = [fractions[number] for number in range(1, result.steps + 1)]
        return derivative_of_steps(method, case.method, problem, displacement, ends), ""
    except MethodError as error:
        return None, f"and {error}"


def _difference(plain: FloatArray, step: Step, why: str) -> tuple[RepairDerivative | None, str]:
    """The derivative of the repair that a step has made of the method's grid ``plain``, and why the step is neither
    that grid nor its repair; empty if it is. ``why`` its steps have no derivative, if they have none."""
    result = step._result
    scale = np.finfo(result.setup.grid.precision).eps * np.abs(result.setup.grid.points).max()
    if np.abs(plain - result.grid.points).max() <= 4.0 * scale:
        return None, ""
    if result.reached < 1.0:
        part = f"only {result.reached:.1%} of the motion was imposed"
        return None, f"{part}; the derivative is that of the method for all of it"
    if result.steps > 1:
        why = why or "with another method"
        return None, f"the motion was imposed in {result.steps} steps, {why}; the derivative is that of one step"
    if result.repair is None:
        return None, "another method replaced the chosen one; the derivative is that of the chosen one"
    if result.setup.boundary.slip.curved:
        return None, "nodes slide on a curved surface; the derivative is that of the method before the repair"
    found = _of_components(result, plain, 4.0 * scale) if result.components else _at_minimum(result, plain, 4.0 * scale)
    return found, "" if found else (
        "the grid was repaired, but is not the minimum of the repair's energy; "
        "the derivative is that of the method before the repair"
    )


def _at_minimum(result: Result, plain: FloatArray, rounding: float) -> RepairDerivative | None:
    """The derivative of the repair from ``plain``, if it reached the minimum of its energy."""
    if result.repair is None or not result.repair.converged:
        return None
    basis, polish = result.setup.undeformed.repairs, result.setup.case.repair.mode == "polish"
    found = derivative_of_repair(basis, plain, result.grid.points, polish)
    return found if found and found.settle(rounding) <= _CLOSE else None


def _of_components(result: Result, plain: FloatArray, rounding: float) -> RepairDerivative | None:
    """The same of an overset grid, whose components are repaired each by itself."""
    grid, own = result.setup.grid, list[tuple[Component, RepairDerivative | None]]()
    for (component, _), (_, each) in zip(result.setup.undeformed.components, result.components, strict=True):
        found = _at_minimum(each, component.rows(grid, plain), rounding)
        if each.repair and not found:
            return None
        own.append((component, found))
    return ComponentRepairs(grid, own)
