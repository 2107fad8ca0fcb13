"""``mesh.linearise``: shapes, errors, and when it is not the derivative of the step."""

import dataclasses
import pickle

import numpy as np
import pytest
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped
from meshdeform.linearisation import differentiated
from meshdeform_core.deform import impose
from meshdeform_core.methods import Options, prepare_method
from meshdeform_core.setup import Timing

BODY = {"where": "abs(x) < 0.51 and abs(y) < 0.51", "select": ["*.i*", "*.j*"], "kind": "moving", "name": "body"}


def case(**method):
    motion = [{"displace": ["0.05*sin(x+1)", "0.05*y", "0"]}]
    span = {"name": "span", "select": ["*.kmin", "*.kmax"], "kind": "slip"}
    return {"boundary": [{**BODY, "motion": motion}, span], "method": method or {"name": "idw-tfi"}}


@pytest.fixture(scope="module")
def mesh():
    return md.prepare(md.Grid([block.copy() for block in wrapped(frame()).blocks]), case())


def bend(mesh, size=0.05):
    return size * np.sin(mesh.points[:, [1, 0, 2]] + 1.0) * [1.0, 1.0, 0.0]


def test_undeformed_and_deformed(mesh):
    change = bend(mesh, 1.0)[:, [1, 0, 2]]
    for at in (None, bend(mesh)):
        found = mesh.linearise(at)
        assert found.exact
        assert found.reason == ""
        assert found.step.valid
        moved, h = found.jvp(change), 1e-5
        base = np.zeros_like(mesh.points) if at is None else at
        one, two = (mesh.deform(base + s * h * change).grid.blocks for s in (1, -1))
        for a, b, block, whole in zip(one, two, moved, mesh.grid.blocks, strict=True):
            assert block.shape == whole.shape
            np.testing.assert_allclose((a - b) / (2 * h), block, atol=1e-7)


def test_operator_and_transpose(mesh):
    found = mesh.linearise(bend(mesh))
    random = np.random.default_rng(1)
    weights = [random.standard_normal(block.shape) for block in mesh.grid.blocks]
    gradient = found.vjp(weights)
    assert gradient.shape == mesh.points.shape
    change = random.standard_normal(mesh.points.shape)
    moved = found.jvp(change)
    product = sum((w * m).sum() for w, m in zip(weights, moved, strict=True))
    assert product == pytest.approx((gradient * change).sum(), rel=1e-11)
    operator = found.operator
    assert operator.shape == (3 * mesh.grid.n_nodes, change.size)
    flat = np.concatenate([m.ravel() for m in moved])
    np.testing.assert_array_equal(operator @ change.ravel(), flat)
    np.testing.assert_array_equal(operator.T @ np.concatenate([w.ravel() for w in weights]), gradient.ravel())


def test_plane_grid():
    blocks = wrapped(frame_2d(5), True).blocks
    body = {**BODY, "motion": [{"displace": ["0.1", "0", "0"]}]}
    flat = md.prepare(md.Grid([block.copy() for block in blocks]), {"boundary": [body]})
    found = flat.linearise()
    moved = found.jvp(np.ones((len(flat.points), 2)))
    assert [m.shape for m in moved] == [b.shape for b in blocks]
    gradient = found.vjp(moved)
    assert not gradient[:, 2].any()
    with pytest.raises(md.MotionError, match="plane"):
        found.jvp(np.ones((len(flat.points), 3)))


def test_several_steps_have_the_derivative_of_one(mesh):
    at, change = bend(mesh, 0.15), bend(mesh, 1.0)[:, [1, 0, 2]]
    one, found = mesh.linearise(at, steps=1, repair="off"), mesh.linearise(at, steps=2)
    assert one.exact
    assert not found.exact
    assert found.reason == "the motion was imposed in 2 steps; the derivative is that of one step"
    for a, b in zip(found.jvp(change), one.jvp(change), strict=True):
        np.testing.assert_array_equal(a, b)


def test_centres_chosen_greedily_are_named(mesh):
    rbf = {"basis": "wendland-c2", "radius": 6.0, "greedy": "hybrid"}
    greedy = md.prepare(md.Grid([block.copy() for block in mesh.grid.blocks]), case(name="rbf", rbf=rbf))
    found = greedy.linearise(bend(greedy), steps=1, repair="off")
    assert not found.exact
    assert "held fixed" in found.reason
    at_rest = greedy.linearise()
    assert not at_rest.exact
    assert "with all centres" in at_rest.reason


def test_a_part_of_the_motion_is_told(mesh):
    found = mesh.linearise(bend(mesh, 3.0), steps="auto", repair="off")
    assert found.step.result.reached < 1.0
    assert not found.exact
    assert "of the motion was imposed; the derivative is that of the method for all of it" in found.reason


def test_another_method_is_told(mesh):
    step = mesh.deform(bend(mesh), steps=1, repair="off")
    method, problem = mesh._method(Timing()), mesh.session.setup.problem
    total = mesh.session.of_boundary(bend(mesh))[problem.source_numbers]
    assert differentiated(step.result, method, total)[1] == ""
    other = prepare_method(Options("tfi"), problem).apply(total)
    replaced = dataclasses.replace(
        step.result, grid=mesh.session.setup.grid.moved(mesh.session.setup.grid.points + other)
    )
    assert "another method replaced the chosen one" in differentiated(replaced, method, total)[1]


def test_bad_arrays(mesh):
    found = mesh.linearise()
    with pytest.raises(md.MotionError, match="displacement"):
        found.jvp(np.ones((3, 3)))
    with pytest.raises(md.GridError, match="gradients for 1 blocks; expected those of the 8 blocks"):
        found.vjp([np.ones((2, 2, 2, 3))])
    zeros = [np.zeros(block.shape) for block in mesh.grid.blocks]
    for given, message in (
        ([*zeros[:-1], np.full(zeros[-1].shape, np.nan)], "block 8 has .* not finite"),
        ([*zeros[:-1], zeros[-1][:-1]], "block 8 has the shape"),
        ([block * 1j for block in zeros], "block 1 has the type complex128"),
        (np.zeros((5, 3)), "gradients for 5 blocks"),
        (["a"] * 8, "block 1 has the type"),
        (None, "gradients for 1 blocks"),
    ):
        with pytest.raises(md.GridError, match=message):
            found.vjp(given)
    with pytest.raises(md.GridError, match="complex numbers"):
        found.operator @ (1j * np.ones(mesh.points.size))


def test_the_step_just_made_is_not_made_again(mesh, monkeypatch):
    made = []
    monkeypatch.setattr("meshdeform.mesh.impose", lambda *given: made.append(1) or impose(*given))
    step = mesh.deform(bend(mesh))
    assert mesh.linearise(bend(mesh)).step is step
    assert len(made) == 1
    assert mesh.linearise(bend(mesh), repair="off").step is not step
    assert mesh.linearise(0.5 * bend(mesh)).step is not step
    assert len(made) == 3
    # What nobody holds is not kept.
    del step
    mesh.deform(bend(mesh))
    mesh.linearise(bend(mesh))
    assert len(made) == 5
    assert pickle.loads(pickle.dumps(mesh)).linearise(bend(mesh)).exact


def test_a_derivative_changes_no_later_step(mesh):
    before = mesh.deform(bend(mesh)).grid.blocks
    found = mesh.linearise(0.5 * bend(mesh))
    found.vjp(found.jvp(bend(mesh)))
    for one, two in zip(before, mesh.deform(bend(mesh)).grid.blocks, strict=True):
        np.testing.assert_array_equal(one, two)


def test_gradients_at_periodic_images_are_alike():
    """Where both sides of a sector hold images of wall nodes, a step along the gradient moves them alike."""
    r, t, z = np.meshgrid(
        np.linspace(1.0, 2.0, 4), np.linspace(0.0, np.pi / 3, 4), np.linspace(0.0, 1.0, 3), indexing="ij"
    )
    grid = md.Grid([np.stack([r * np.cos(t), r * np.sin(t), z], axis=-1)])
    mesh = md.prepare(
        grid,
        moving=["block1.imin"],
        periodic={"sides": ["block1.jmin", "block1.jmax"]},
        free=["block1.k*"],
        method="idw",
    )
    outward = mesh.points * [1.0, 1.0, 0.0]
    at = mesh.linearise(0.03 * outward)
    weights = [np.cos(3.0 * block) for block in mesh.grid.blocks]
    gradient = at.vjp(weights)
    assert mesh.deform(0.03 * outward - 1e-3 * gradient).valid
    for change in (outward * mesh.points[:, 2:], gradient):
        product = sum(float((w * moved).sum()) for w, moved in zip(weights, at.jvp(change), strict=True))
        assert product == pytest.approx(float((gradient * change).sum()), rel=1e-12)
