"""The derivative of a deformed grid, through its method, steps and repairs; or the reason why it has none."""

from __future__ import annotations

import numpy as np

from meshdeform_core.deform import Result
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.components import PreparedComponents, named
from meshdeform_core.methods.derivative import ComponentsDerivative, Derivative, StepsDerivative, derivative_of
from meshdeform_core.parallel import Part, combined, of_all, own_rows
from meshdeform_core.repair.derivative import RepairDerivative, derivative_of_repair
from meshdeform_core.stepping.retraced import retraced

_CLOSE = 1e-4
"""A repaired grid farther from the minimum than this fraction of the shortest edge, round-off aside, is not at it."""
_IN_PARTS = "in parts, and the derivative of that takes the whole grid on every rank"
_NOT_MINIMAL = "the grid was repaired, but is not the minimum of the repair's energy"


def differentiated(result: Result, method: PreparedMethod, displacement: FloatArray) -> tuple[Derivative, str]:
    """The derivative of a deformed grid, and the reason why it does not hold for this grid; empty if it does.

    ``method`` is prepared on the undeformed grid, and ``displacement`` (n_sources, 3) that of its sources. The
    components of an overset grid have derivatives of their own.
    """
    if isinstance(method, PreparedComponents):
        parts = zip(method.parts, result.components, strict=True)
        found = [differentiated(own, each, displacement[rows]) if each else None for (_, each, rows), (_, own) in parts]
        names = [component.name for (component, _), _, _ in method.parts]
        reasons = [named(name, each[1]) for name, each in zip(names, found, strict=True) if each and each[1]]
        return ComponentsDerivative(method, [each[0] if each else None for each in found]), "; ".join(reasons)
    if result.steps > 1 and result.reached == 1.0:
        return _of_steps(result, method, displacement)
    return _of_one_step(result, method, displacement)


def _of_one_step(result: Result, method: PreparedMethod, displacement: FloatArray) -> tuple[Derivative, str]:
    derivative = derivative_of(method, displacement)
    points = combined(np.add, result.setup.grid.points, method.apply(displacement))
    if _same(points, result):
        return derivative, ""
    if result.reached < 1.0:
        part = f"only {result.reached:.1%} of the motion was imposed"
        return derivative, f"{part}; the derivative is that of the method for all of it"
    if result.repair is None:
        return derivative, "another method replaced the chosen one; the derivative is that of the chosen one"
    try:
        repair = _of_repair(result, points, result.grid.points, result.repair.converged, _rounding(result))
    except MethodError as error:
        return derivative, f"{error}; the derivative is that of the method before the repair"
    return _Repaired(derivative, repair), ""


def _of_steps(result: Result, method: PreparedMethod, displacement: FloatArray) -> tuple[Derivative, str]:
    """The derivative by the chain rule; where that does not apply, the derivative of the method in one step."""
    setup, total = result.setup, result.displacement
    if isinstance(setup.grid.points, Part):
        return derivative_of(method, displacement), _in_one_step(result, _IN_PARTS)
    trials = retraced(setup, lambda part: total if part == 1.0 else part * total, method, result.ends)

    def mend(plain: FloatArray) -> tuple[FloatArray, RepairDerivative | None]:
        trial = next(trials)
        if trial.repair is None:
            return plain, None
        return trial.found.points, _of_repair(result, plain, trial.found.points, trial.repair.converged, 0.0)

    repairs = {} if result.repair is None else {"mend": mend}
    try:
        chain = StepsDerivative(method, setup.case.method, setup.problem, displacement, result.ends, **repairs)
        why = "" if _same(chain.points, result) else "with another method"
    except MethodError as error:
        why = f"and {error}"
    if not why:
        return chain, ""
    return derivative_of(method, displacement), _in_one_step(result, why)


def _in_one_step(result: Result, why: str) -> str:
    return f"the motion was imposed in {result.steps} steps, {why}; the derivative is that of one step"


def _of_repair(
    result: Result, plain: FloatArray, points: FloatArray, converged: bool, rounding: float
) -> RepairDerivative:
    """The derivative of the repair from ``plain`` to ``points`` (n_nodes, 3), which are rounded by up to ``rounding``.

    Raises
    ------
    MethodError
        Where these are not the minimum of its energy, or this has no derivative.
    """
    setup = result.setup
    if isinstance(plain, Part):
        raise MethodError(f"the grid was repaired {_IN_PARTS}")
    if not converged:
        raise MethodError(_NOT_MINIMAL)
    found = derivative_of_repair(setup.undeformed.repairs, plain, points, setup.case.repair.mode == "polish")
    if found is None or found.settle(rounding) > _CLOSE:
        raise MethodError(_NOT_MINIMAL)
    return found


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
