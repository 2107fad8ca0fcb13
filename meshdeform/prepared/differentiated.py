"""The derivative of a deformed grid, through its method and repair; or the reason why it is not exact."""

from __future__ import annotations

import numpy as np

from meshdeform_core.deform import Result
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.derivative import Derivative, derivative_of
from meshdeform_core.overset import PreparedComponents
from meshdeform_core.parallel import Part, combined, of_all, own_rows
from meshdeform_core.repair.derivative import RepairDerivative, derivative_of_repair

_CLOSE = 1e-4
"""A repaired grid farther from the minimum than this fraction of the shortest edge, round-off aside, is not at it."""
_NOT_MINIMAL = "but is not the minimum of the repair's energy"


def differentiated(result: Result, method: PreparedMethod, displacement: FloatArray) -> tuple[Derivative, str]:
    """The derivative of a deformed grid, and the reason why it does not hold for this grid; empty if it does.

    ``method`` is prepared on the undeformed grid, and ``displacement`` (n_sources, 3) that of its sources. The
    components of an overset grid have derivatives of their own.
    """
    if isinstance(method, PreparedComponents):
        return method.differentiated(result, displacement, differentiated)
    derivative = derivative_of(method, displacement)
    if result.steps > 1 and result.reached == 1.0:
        return derivative, f"the motion was imposed in {result.steps} steps; the derivative is that of one step"
    points = combined(np.add, result.setup.grid.points, method.apply(displacement))
    if _same(points, result):
        return derivative, ""
    if result.reached < 1.0:
        part = f"only {result.reached:.1%} of the motion was imposed"
        return derivative, f"{part}; the derivative is that of the method for all of it"
    if result.repair is None:
        return derivative, "another method replaced the chosen one; the derivative is that of the chosen one"
    repair, why = _of_repair(result, points)
    if repair is None:
        return derivative, f"the grid was repaired, {why}; the derivative is that of the method before the repair"
    return _Repaired(derivative, repair), ""


def _of_repair(result: Result, plain: FloatArray) -> tuple[RepairDerivative | None, str]:
    """The derivative of the repair of ``plain`` (n_nodes, 3), or the reason why it has none."""
    setup = result.setup
    if isinstance(plain, Part):
        return None, "in parts, and the derivative of that takes the whole grid on every rank"
    if result.repair is None or not result.repair.converged:
        return None, _NOT_MINIMAL
    polish = setup.case.repair.mode == "polish"
    found = derivative_of_repair(setup.undeformed.repairs, plain, result.grid.points, polish)
    if found is None or found.settle(_rounding(result)) > _CLOSE:
        return None, _NOT_MINIMAL
    return found, ""


def _rounding(result: Result) -> float:
    """Largest difference between the coordinates of the result and those before rounding."""
    return 4.0 * float(np.finfo(result.setup.grid.precision).eps) * _largest(result.setup.grid.points)


def _same(points: FloatArray, result: Result) -> bool:
    return _largest(combined(np.subtract, points, result.grid.points)) <= _rounding(result)


def _largest(values: FloatArray) -> float:
    """Largest magnitude of ``values`` (n_nodes, 3), of all ranks if they are in parts."""
    own = values[slice(*own_rows(values))]
    return max(of_all(values, max(float(own.max(initial=0.0)), -float(own.min(initial=0.0)))))


class _Repaired:
    """Derivative of a method followed by a repair."""

    def __init__(self, method: Derivative, repair: RepairDerivative) -> None:
        self._method, self._repair, self.kinks = method, repair, method.kinks

    def push(self, change: FloatArray) -> FloatArray:
        return self._repair.push(self._method.push(change))

    def pull(self, gradient: FloatArray) -> FloatArray:
        return self._method.pull(self._repair.pull(gradient))
