"""A displacement field follows from the grid, the method and the displacement alone.

It does not depend on earlier displacements, the memory limit or the number of threads: compared to the last bit, with
exact and with fast sums.
"""

import dataclasses
import functools
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cases import ALL_METHODS, REPEATED, body_specs, constant, every, problem_of, told, turning
from grids import frame, frame_2d

from meshdeform.mesh import Mesh
from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, set_up
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import IDW, RBF, Options, make_method
from meshdeform_core.parallel import ONE_PROCESS, set_sharing
from meshdeform_core.repair.options import Limit
from meshdeform_core.setup import Timing
from meshdeform_core.stepping import Course, beginning, prepared_on

FAST_IDW = {
    "lie": {},
    "none": {"rotation": "none"},
    "quaternion": {"rotation": "quaternion"},
    "blend": {"rotation": "blend"},
    "division": {"rotation": "division", "divisions": 2},
    "automatic alpha": {"alpha": "auto"},
    "two exponents": {"weights": "shepard", "p_moving": 4.0},
    "one body, double precision": {"summation_tolerance": 1e-4},
    "no transition": {"transition": 0, "remove_mean": False},
}
METHODS = {
    **ALL_METHODS,
    "rbf-greedy": Options("rbf", rbf=RBF(basis="wendland-c2", radius=6.0, greedy="hybrid", greedy_updates=40)),
    **{f"fast {name}": Options("idw", idw=IDW(summation="fast", **kind)) for name, kind in FAST_IDW.items()},
    "fast idw-tfi": Options("idw-tfi", idw=IDW(summation="fast")),
    "fast rbf": Options("rbf", rbf=RBF(summation="fast", solver="krylov")),
    "fast rbf, compact": Options("rbf", rbf=RBF(summation="fast", basis="wendland-c2", radius=1.5)),
}
EVERY = every(
    METHODS,
    REPEATED
    | {
        "idw-none", "idw-quaternion", "idw-division", "idw-shepard",
        "fast division", "fast automatic alpha", "idw-blend", "idw-tfi", "idw-rbf", "rbf-krylov",
        "rbf-wendland-c2", "fast none", "fast quaternion", "fast blend", "fast two exponents", "fast no transition",
        "fast idw-tfi",
    },
)  # fmt: skip


def grid_of(name):
    return frame(7, 5) if name.startswith("fast") else frame()


def problem(name, memory=None):
    found = problem_of(grid_of(name), body_specs(turning(20, center=(0.3, 0.1, 0.0))))
    return found if memory is None else dataclasses.replace(found, memory=MemoryLimit(memory, "the test allows"))


def displacements(where):
    """Large, small, at rest in places, and of another kind."""
    at, x = told(where), where.source_points
    return [at, 0.01 * at, 0.0 * at, at * (x[:, :1] > 0.0), 0.6 * at * np.cos(3 * x), 3 * at * x[:, 2:]]


def moved(options, where, displacement):
    return make_method(options).prepare(where).apply(displacement)


@functools.cache
def alone(name, number):
    """The field of a displacement, and what is reported, by a method prepared for nothing else."""
    where = problem(name)
    prepared = make_method(METHODS[name]).prepare(where)
    return prepared.apply(displacements(where)[number]), prepared.account


@EVERY
def test_neither_earlier_displacements_nor_memory_nor_threads_change_a_bit(name):
    """Twice each, so that what is kept is used: nothing of it fits into the least memory."""
    given = displacements(problem(name))
    # Systems of equations have to fit.
    least = 0 if METHODS[name].name in ("tfi", "idw", "idw-tfi") else 2**25
    for memory, threads in ((least, 1), (2**33, 2)):
        set_sharing(threads=threads)
        try:
            prepared = make_method(METHODS[name]).prepare(problem(name, memory))
            for number in (3, 0, 4, 0, 2, 4):
                field, account = alone(name, number)
                np.testing.assert_array_equal(prepared.apply(given[number]), field)
                assert prepared.account.settings == account.settings
                assert prepared.account.warnings == account.warnings
        finally:
            set_sharing(threads=None)


MANY_SOURCES = """
import numpy as np
from cases import problem_of, everything_moves
from grids import block_around
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW

line = np.linspace(0.0, 1.0, 340)
where = problem_of(Grid.from_blocks([block_around(line, line, np.array([0.0, 0.1]))]), everything_moves())
x = where.source_points
assert len(x) > 200_000
for options in (IDW(), IDW(alpha="auto"), IDW(rotation="none")):
    prepared = options.bind(where, np.arange(0))
    found = prepared.fit(0.1 * np.sin(3.0 * x[:, ::-1]))
    frame = [each for each in (found.frame.shift, found.frame.turn, found.frame.centre) if each is not None]
    print([each.tobytes().hex() for each in frame], found.weights, found.values.sum(axis=1).tolist())
"""


@pytest.mark.slow
def test_threads_of_linear_algebra_change_no_bit_of_many_sources():
    """A program that uses the library decides on these threads; their number changes how a BLAS adds up long rows."""
    tests = os.pathsep.join([str(Path(__file__).parent.parent), *sys.path])
    told = []
    for threads in ("1", "2"):
        own = os.environ | {"PYTHONPATH": tests, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        done = subprocess.run([sys.executable, "-c", MANY_SOURCES], env=own, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told.append(done.stdout)
    assert told[0] == told[1]


def mesh_of(options: Options) -> Mesh:
    """A hollow bar in a frame; two of its sides move, no cells lie between them."""
    left = BoundarySpec("left", ("block2.imax",), Kind.MOVING, None, constant(0, 0, 0))
    right = BoundarySpec("right", ("block7.imin",), Kind.MOVING, None, constant(0, 0, 0))
    return Mesh(set_up(frame_2d(), Case((left, right), {}, options)), False, ONE_PROCESS, None)


def bulge(depth: float, points: np.ndarray, _: float) -> np.ndarray:
    """The left side bends by ``depth`` to the right."""
    return np.stack([depth * (1.0 - 4.0 * points[:, 1] ** 2) * (points[:, 0] < 0.0), *np.zeros((2, len(points)))], 1)


def wave(depth: float, points: np.ndarray, _: float) -> np.ndarray:
    """Both sides bend in ``depth`` waves' height: cells are crushed, if it is large."""
    return np.stack([depth * np.sin(9.0 * points[:, 1]), 0.5 * depth * points[:, 0], np.zeros(len(points))], 1)


CALLS = {
    "nothing": (partial(bulge, 0.0), {}),
    "harmless": (partial(bulge, -1.2), {"repair": "off"}),
    "through the other side": (partial(bulge, 1.2), {"repair": "off"}),
    "a little less": (partial(bulge, 1.19), {"repair": "off"}),
    "invalid": (partial(wave, 0.9), {"repair": "off"}),
    "smaller steps": (partial(wave, 0.9), {"repair": "off", "steps": "auto"}),
    "repaired": (partial(wave, 0.7), {"repair": "auto"}),
    "two steps": (partial(wave, 0.3), {"repair": "off", "steps": 2}),
}


@pytest.mark.parametrize("name", ["idw-tfi", pytest.param("rbf-tfi", marks=pytest.mark.slow)])
def test_calls_in_any_order_give_what_they_give_alone(name):
    alone = {call: mesh_of(ALL_METHODS[name]).deform(told, **more).result for call, (told, more) in CALLS.items()}
    # The calls differ in what they are to show.
    crossing = {call for call, each in alone.items() if any("crosses itself" in text for text in each.warnings)}
    assert {"through the other side", "a little less"} <= crossing
    assert "harmless" not in crossing
    assert not alone["invalid"].valid
    assert alone["repaired"].repair is not None
    assert alone["smaller steps"].steps > 1
    assert alone["harmless"].max_displacement == alone["through the other side"].max_displacement
    order = np.random.default_rng(len(name)).permutation([*CALLS, *CALLS])
    mesh = mesh_of(ALL_METHODS[name])
    for call in order.tolist():
        told, more = CALLS[call]
        found, expected = mesh.deform(told, **more).result, alone[call]
        assert found.warnings == expected.warnings, call
        assert found.attempts == expected.attempts, call
        assert (found.valid, found.steps, found.reached) == (expected.valid, expected.steps, expected.reached)
        assert found.assessment == expected.assessment, call
        assert found.account == expected.account, call
        np.testing.assert_array_equal(found.grid.points, expected.grid.points, err_msg=call)


def test_a_prepared_method_is_used_again_for_its_own_grid_and_options_only():
    setup = mesh_of(Options("tfi")).setup
    course = Course(setup, setup.motion(0.0), "float64", Timing(), None, Limit())
    state = beginning(course, setup.case.method)
    elsewhere = dataclasses.replace(state.found, points=state.found.points.copy())
    moved, other = (
        dataclasses.replace(state, **new) for new in ({"found": elsewhere}, {"options": Options("idw-tfi")})
    )
    first = prepared_on(state)
    assert prepared_on(state) is first
    assert prepared_on(moved) is not first
    again = prepared_on(state)
    assert again is not first
    assert prepared_on(other) is not again
