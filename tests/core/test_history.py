"""What a prepared mesh gives does not depend on earlier calls: the whole result, against a mesh that has made none."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from cases import ALL_METHODS, constant
from grids import frame_2d

from meshdeform.mesh import Mesh
from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, set_up
from meshdeform_core.methods import Options
from meshdeform_core.parallel import Ranks
from meshdeform_core.repair.options import Limit
from meshdeform_core.setup import Timing
from meshdeform_core.stepping import Course, beginning, prepared_on


def mesh_of(options: Options) -> Mesh:
    """A hollow bar in a frame; two of its sides move, no cells lie between them."""
    left = BoundarySpec("left", ("block2.imax",), Kind.MOVING, None, constant(0, 0, 0))
    right = BoundarySpec("right", ("block7.imin",), Kind.MOVING, None, constant(0, 0, 0))
    return Mesh(set_up(frame_2d(), Case((left, right), {}, options)), False, Ranks(), None)


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


def test_the_calls_differ_in_what_they_are_to_show():
    """Else the test above would compare the same thing over and over."""
    mesh = mesh_of(Options("tfi"))
    found = {call: mesh.deform(told, **more).result for call, (told, more) in CALLS.items()}
    crossing = {call for call, each in found.items() if any("crosses itself" in text for text in each.warnings)}
    assert {"through the other side", "a little less"} <= crossing
    assert "harmless" not in crossing
    assert not found["invalid"].valid
    assert found["repaired"].repair is not None
    assert found["smaller steps"].steps > 1
    assert found["harmless"].max_displacement == found["through the other side"].max_displacement


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
