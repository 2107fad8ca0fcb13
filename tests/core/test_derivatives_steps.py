"""Derivatives of several steps: later ones are prepared on the grid that the first has reached, and depend on it."""

import dataclasses

import numpy as np
import pytest
from cases import body_specs, problem_of, turning
from derivative_cases import KINDS, METHODS, directions
from grids import frame

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.errors import MethodError
from meshdeform_core.methods import RBF, Options, make_method, prepare_method
from meshdeform_core.methods.derivative import StepsDerivative
from meshdeform_core.methods.derivative.grid.gaps import InGapsGridDerivative

PLACES = KINDS | {"sub-blocks": lambda: problem_of(frame(7, 5), body_specs(turning(10)))}
OF_IDW = [(name, "slip") for name in METHODS if name.startswith("idw") and name not in ("idw-rbf", "idw-tfi")]
BOUNDARIES = [(name, kind) for kind in PLACES if kind != "slip" for name in ("tfi", "idw-tfi")]
ENDS = (0.4, 0.7, 1.0)


def imposed(options, where, displacement):
    """The grid that the steps reach, by preparing each one anew."""
    points, before = where.grid.points, 0.0 * displacement
    for end in ENDS:
        here = dataclasses.replace(where, grid=where.grid.moved(points))
        points = points + prepare_method(options, here).apply(end * displacement - before)
        before = end * displacement
    return points


# The filler of the hybrid is the same TFI.
OF_RBF = [
    *((name, "slip") for name in METHODS if name.startswith("rbf") and name not in ("rbf-minres", "rbf-krylov")),
    *(("idw-rbf", kind) for kind in ("slip", "periodic", "curved slip")),
    *(("rbf-tfi", kind) for kind in ("symmetry", "plane")),
]
LONG = [pytest.param(*each, marks=pytest.mark.slow) for each in BOUNDARIES if each[0] == "tfi"]
SHORT = [each for each in BOUNDARIES if each[0] != "tfi"]


@pytest.mark.parametrize(("name", "kind"), [("tfi", "slip"), *OF_IDW, *OF_RBF, *SHORT, *LONG])
def test_central_differences_and_transposes(name, kind):
    where, options = PLACES[kind](), METHODS[name]
    smooth, rough = directions(where)
    # Of a symmetric body several nodes are the farthest from its centre, and on a curved surface none may pass an edge.
    at = (0.3 if kind == "curved slip" else 1.0) * smooth * (1.0 + 0.2 * where.source_points @ [[1.0], [0.5], [0.3]])
    check(options, where, at, 0.02 * rough + 0.01 * smooth[:, [1, 0, 2]])


@pytest.mark.parametrize("name", ["idw-tfi", "idw-lie"])
def test_gaps_that_close(name):
    """The share of TFI follows how wide a gap still is, and how wide it was before the step."""
    where, options = PLACES["slip"](), METHODS[name]
    smooth, rough = directions(where)
    moving = smooth.any(axis=1, keepdims=True)
    at = moving * [0.9, 0.13, 0.0] + 0.2 * smooth * (1.0 + 0.2 * where.source_points @ [[1.0], [0.5], [0.3]])
    found = check(options, where, at, 0.02 * rough + 0.01 * smooth[:, [1, 0, 2]])
    assert isinstance(found._later[-1], InGapsGridDerivative) == (name == "idw-tfi")


def check(options, where, at, change, tied=False):
    """Central differences fall as h^2, and the transpose is one."""
    found = StepsDerivative(make_method(options).prepare(where), options, where, at, ENDS)
    np.testing.assert_allclose(found.points, imposed(options, where, at), rtol=0, atol=1e-14)
    assert bool(found.kinks) == tied
    moved, errors = found.push(change), []
    for h in (2.4e-4, 6e-5):
        one, two = (imposed(options, where, at + sign * h * change) for sign in (1, -1))
        errors.append(np.abs((one - two) / (2.0 * h) - moved).max() / np.abs(moved).max())
    assert errors[1] < 1e-6
    # Solutions of systems are less accurate than sums, which differences divide by h.
    assert errors[1] < errors[0] / 12 or errors[1] < (1e-7 if "rbf" in options.name else 2e-9)
    weight = np.random.default_rng(6).standard_normal(moved.shape)
    gap = (weight * moved).sum() - (found.pull(weight.copy()) * change).sum()
    assert abs(gap) < 1e-12 * np.linalg.norm(weight) * np.linalg.norm(moved)
    return found


def test_later_steps_are_not_those_of_the_first_grid():
    """What the chain rule adds is large enough for the differences above to see it."""
    where, options = PLACES["slip"](), METHODS["idw-tfi"]
    smooth, rough = directions(where)
    found = StepsDerivative(make_method(options).prepare(where), options, where, smooth, ENDS)
    moved, apart = found.push(rough), found._first.push(ENDS[0] * rough)
    for part, step in zip(found._parts[1:], found._later, strict=True):
        apart = apart + step.push(part * rough, np.zeros_like(moved))
    assert np.abs(moved - apart).max() > 0.01 * np.abs(moved).max()


@pytest.mark.parametrize("name", ["rbf", "rbf-tfi", "idw-rbf"])
def test_an_automatic_radius_follows_the_grid(name):
    """Of blocks it is a diagonal between flat sides, all nodes of which are the farthest."""
    where, options = PLACES["slip"](), Options(name, rbf=RBF(basis="wendland-c2"))
    smooth, rough = directions(where)
    at = smooth * (1.0 + 0.2 * where.source_points @ [[1.0], [0.5], [0.3]])
    found = check(options, where, at, 0.02 * rough + 0.01 * smooth[:, [1, 0, 2]], tied=name == "idw-rbf")
    radius = (
        found._later[-1]._mover._derivative._radius if name != "idw-rbf" else found._later[-1]._filler._blocks[0][2]
    )
    assert radius.push(found.push(rough)) != 0.0


def test_centres_that_are_chosen_anew_in_every_step_are_refused():
    where, chosen = PLACES["slip"](), Options("rbf", rbf=RBF(basis="wendland-c2", greedy="hybrid", radius=6.0))
    method = make_method(chosen).prepare(where)
    with pytest.raises(MethodError, match="greedy has no derivative"):
        StepsDerivative(method, chosen, where, directions(where)[0], ENDS)


def test_centres_in_a_plane_that_they_may_leave_are_refused():
    floor = BoundarySpec("floor", ("*.kmin",), Kind.MOVING, None, turning(10))
    where = problem_of(frame(), [floor, BoundarySpec("rest", ("*.i*", "*.j*", "*.kmax"), Kind.FREE)])
    at = 0.1 * np.sin(where.source_points[:, [1, 0, 2]]) * [1.0, 1.0, 0.0]
    method = make_method(Options("rbf")).prepare(where)
    with pytest.raises(MethodError, match="in a plane, or on a line, has no derivative"):
        StepsDerivative(method, Options("rbf"), where, at, ENDS)
