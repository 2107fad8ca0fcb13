"""Small deformations, derivatives and pictures use every loop, with the types of arguments that it declares."""

import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from meshdeform_cli.work import cells_of
from meshdeform_core.deform import Case, Result, deform, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, RBF, Options, make_method
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.fastsum.nested import NestedSums
from meshdeform_core.repair import Mode, RepairOptions
from meshdeform_core.repair.derivative import derivative_of_repair
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats.case import case_of
from meshdeform_formats.fields import ALL, with_fields
from meshdeform_formats.picture.overview import quality_planes
from meshdeform_formats.picture.page import page_bytes
from meshdeform_formats.picture.subject import Subject
from meshdeform_samples import case_content, generate

_FAST_IDW, _FAST_RBF = IDW(summation="fast"), RBF(summation="fast", solver="krylov")


def runs() -> Iterator[Callable[[], object]]:
    """Runs of small samples that together use every loop."""
    yield partial(_deformed, "hemisphere", 8, Options("tfi"))
    yield _nested_sums
    yield partial(_repair_derivatives, "hemisphere", 8, Options("tfi"), amplitude=0.045)
    yield partial(_deformed, "hemisphere", 8, Options("idw", idw=_FAST_IDW))
    yield partial(_derivatives, "cascade", 16, Options("rbf", rbf=_FAST_RBF))
    yield partial(_deformed, "hemisphere", 8, Options("idw-tfi"))
    yield partial(_series, "splitter-plate", 8, Options("idw-tfi", idw=_FAST_IDW))
    yield partial(_repair_derivatives, "cascade", 8, Options("tfi"), angle=60.0)
    yield partial(_derivatives, "hemisphere", 8, Options("idw", idw=IDW(rotation="quaternion", summation="fast")))
    yield partial(_pictures, "hemisphere", 8, Options("tfi"))
    # Sub-blocks with curved grid lines.
    yield partial(_derivatives, "airfoil", 33, Options("idw-tfi"))
    for rotation in ("none", "quaternion", "blend"):
        yield partial(_deformed, "hemisphere", 8, Options("idw", idw=IDW(rotation=rotation, summation="exact")))
    yield partial(_deformed, "hemisphere", 8, Options("rbf-tfi"))
    yield partial(_derivatives, "hemisphere", 8, Options("rbf", rbf=RBF("wendland-c2", radius=1.0, greedy="hybrid")))
    yield partial(_deformed, "airfoil", 33, Options("idw-tfi"))
    yield partial(_series, "square", 11, Options("tfi"))
    yield partial(_derivatives, "hemisphere", 8, Options("tfi"))


def _sample(name: str, size: int, method: Options, repair: Mode = "auto", **constants: float) -> tuple[Grid, Case]:
    grid, tables = generate(name, size)
    content: dict[str, Any] = case_content(name, tables)
    content["constants"] = {**content.get("constants", {}), **constants}
    case = case_of(content).case
    return grid, Case(case.boundaries, case.constants, method, repair=RepairOptions(repair))


def _deformed(name: str, size: int, method: Options, repair: Mode = "off", **constants: float) -> Result:
    return deform(*_sample(name, size, method, repair, **constants), time=2.5e-4)


def _derivatives(name: str, size: int, method: Options) -> None:
    setup = set_up(*_sample(name, size, method))
    displacement = setup.displacement(2.5e-4)[setup.problem.source_numbers]
    derivative = make_method(method).prepare(setup.problem).linearised(displacement)
    derivative.pull(derivative.push(displacement))


def _repair_derivatives(name: str, size: int, method: Options, **constants: float) -> None:
    result = _deformed(name, size, method, "auto", **constants)
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
    setup = result.setup
    before = Subject(setup.grid, setup.topology, original=setup.original)
    page_bytes(quality_planes(before, Subject(result.grid, setup.topology, setup.grid, original=before)))


def _nested_sums() -> None:
    """Nested sums; a whole run with enough centres for them would take long."""
    line = np.linspace(0.0, 1.0, 2000)[:, None] * np.ones(3)
    NestedSums(BASES["tps"], line, 1e-6)(np.ones_like(line))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_every_loop_that_is_called_declares_the_types_of_its_arguments():
    """In a process of its own, which finds all loops compiled: loops that others call are part of these there."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == [""]


def report() -> None:
    """Print the loops that are never called, and those called with other types than they declare."""
    import gc

    from numba.core.dispatcher import Dispatcher

    from meshdeform_core.numerics.jit import declared_loops

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for run in runs():
            run()
    declared = declared_loops()
    for loop in (each for each in gc.get_objects() if isinstance(each, Dispatcher)):
        name = f"{loop.py_func.__module__}.{loop.py_func.__qualname__}"
        called = [tuple(each) for each in loop.signatures]
        if name in declared and not called:
            print(f"{name} is never called")
        elif name.startswith("meshdeform") and set(called) - set(declared.get(name, [])):
            print(f"{name} is called with {called}, and declares {declared.get(name)}")


if __name__ == "__main__":
    report()
