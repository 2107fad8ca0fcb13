"""Small deformations, repairs and pictures that together use every compiled loop."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from meshdeform_core.deform import Case, Result, deform, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, RBF, Options, Progress, make_method, prepare_method
from meshdeform_core.methods.derivative import StepsDerivative, derivative_of
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.fastsum.radial.nested import NestedSums
from meshdeform_core.repair.derivative import derivative_of_repair
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats.case import case_of
from meshdeform_formats.fields import ALL, with_fields
from meshdeform_formats.report.illustrations import deformation_figures
from meshdeform_samples import case_content, generate

from .work import cells_of

_FAST_IDW, _FAST_RBF = IDW(summation="fast"), RBF(summation="fast", solver="krylov")


def options() -> Iterator[tuple[str, int, Options]]:
    """Sample, size and method of the runs that deform a sample."""
    for sample, size in (("hemisphere", 8), ("square", 11)):
        yield from ((sample, size, Options(name)) for name in ("tfi", "idw-tfi", "rbf-tfi", "idw-rbf"))
    for rotation in ("none", "quaternion", "blend"):
        yield "hemisphere", 8, Options("idw", idw=IDW(rotation=rotation, summation="exact"))
    yield "hemisphere", 8, Options("idw", idw=IDW(summation="fast"))
    yield "hemisphere", 8, Options("rbf", rbf=RBF(basis="wendland-c2", radius=1.0, greedy="single"))
    yield "hemisphere", 8, Options("rbf", rbf=_FAST_RBF)
    yield "hemisphere", 8, Options("rbf", rbf=RBF(basis="wendland-c2", radius=0.1, solver="krylov"))
    yield "cascade", 16, Options("idw-tfi")
    # Sub-blocks with curved grid lines.
    yield "airfoil", 33, Options("idw-tfi")
    yield "splitter-plate", 8, Options("idw-tfi", idw=_FAST_IDW)


def runs() -> Iterator[Callable[[], object]]:
    """The functions to call, in this order."""
    yield from (partial(_deformed, *each) for each in options())
    # A table with triangles.
    yield partial(_deformed, "wing", 8, Options("idw-tfi"))
    # A plane grid to repair, and a boundary that crosses itself.
    yield partial(_deformed, "splitter-plate", 8, Options("tfi"), angle=40.0)
    yield partial(_deformed, "splitter-plate", 8, Options("tfi"), amplitude=200.0)
    yield partial(_series, "splitter-plate", 8, Options("tfi"))
    yield partial(_series, "square", 11, Options("tfi"))
    yield partial(_derivatives, "hemisphere", 8, Options("tfi"))
    yield partial(_derivatives, "airfoil", 33, Options("idw-tfi"))
    yield partial(_derivatives, "hemisphere", 8, Options("idw", idw=IDW(rotation="quaternion", summation="fast")))
    yield partial(_derivatives, "cascade", 16, Options("rbf", rbf=_FAST_RBF))
    yield partial(_step_derivatives, "hemisphere", 8, Options("idw-tfi"))
    yield partial(_step_derivatives, "airfoil", 33, Options("idw-tfi"))
    yield partial(_step_derivatives, "square", 11, Options("tfi"))
    yield partial(_step_derivatives, "hemisphere", 8, Options("idw", idw=IDW(rotation="quaternion")))
    yield partial(_repair_derivatives, "splitter-plate", 8, Options("tfi"), angle=40.0)
    yield partial(_repair_derivatives, "hemisphere", 8, Options("tfi"), amplitude=0.045)
    yield partial(_pictures, "hemisphere", 8, Options("tfi"))
    yield _nested_sums


def run_everything(progress: Progress) -> None:
    """Call all of :func:`runs` and discard the results."""
    done = list(runs())
    for number, each in enumerate(done):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            each()
        progress("warm-up", number + 1, len(done))


def _sample(name: str, size: int, method: Options, **constants: float) -> tuple[Grid, Case]:
    grid, tables = generate(name, size)
    content: dict[str, Any] = case_content(name, tables)
    content["constants"] = {**content.get("constants", {}), **constants}
    case = case_of(content).case
    return grid, Case(case.boundaries, case.constants, method)


def _deformed(name: str, size: int, method: Options, **constants: float) -> Result:
    return deform(*_sample(name, size, method, **constants), time=2.5e-4)


def _derivatives(name: str, size: int, method: Options) -> None:
    setup = set_up(*_sample(name, size, method))
    displacement = setup.displacement(2.5e-4)[setup.problem.source_numbers]
    derivative = derivative_of(make_method(method).prepare(setup.problem), displacement)
    derivative.pull(derivative.push(displacement))


def _step_derivatives(name: str, size: int, method: Options) -> None:
    setup = set_up(*_sample(name, size, method))
    displacement = setup.displacement(2.5e-4)[setup.problem.source_numbers]
    first = prepare_method(method, setup.problem)
    derivative = StepsDerivative(first, method, setup.problem, displacement, (0.5, 1.0))
    derivative.pull(derivative.push(displacement))


def _repair_derivatives(name: str, size: int, method: Options, **constants: float) -> None:
    result = _deformed(name, size, method, **constants)
    points = result.grid.points
    derivative = derivative_of_repair(result.setup.undeformed.repairs, points, points, polish=False)
    if derivative:
        derivative.pull(derivative.push(np.ones_like(points)))


def _series(name: str, size: int, method: Options) -> None:
    setup = set_up(*_sample(name, size, method))
    # The second level has the motion of the first one.
    for _ in deform_series(setup, Schedule((0.0, 1.0), velocity="swept"), "float64"):
        pass


def _pictures(name: str, size: int, method: Options) -> None:
    result = _deformed(name, size, method)
    with_fields(cells_of(result.setup, result.grid), [ALL])
    deformation_figures(result)


def _nested_sums() -> None:
    """Products with so many centres that a whole run would take long."""
    line = np.linspace(0.0, 1.0, 2000)[:, None] * np.ones(3)
    NestedSums(BASES["tps"], line, 1e-6)(np.ones_like(line))
