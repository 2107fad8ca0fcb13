"""``mesh.linearise``: shapes, errors, and when it is not the derivative of the step."""

import dataclasses

import numpy as np
import pytest
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped
from meshdeform_core.grid.parts import FileFormat
from meshdeform_core.quality.gradients import quality_gradient
from meshdeform_core.repair import untangle

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
    step = mesh.deform(bend(mesh))
    found = mesh.linearise(bend(mesh))
    assert found.step is step
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


def test_a_part_of_the_motion_is_told(mesh):
    found = mesh.linearise(bend(mesh, 3.0), steps="auto", repair="off")
    assert found.step.result.reached < 1.0
    assert not found.exact
    assert "of the motion was imposed; the derivative is that of the method for all of it" in found.reason
    half = mesh.linearise(mesh.points * [-2.0, -2.0, 0.0], steps=1, repair="off").reason
    assert half.startswith("80 wall nodes turn by 180 degrees, where the direction of rotation jumps")


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


def test_at_a_repaired_grid(monkeypatch):
    """Exact at the minimum, that of single precision, too; where the repair ended elsewhere, it says so."""
    grid = md.Grid([block.astype(np.float32) for block in wrapped(frame_2d(9), True).blocks]).core
    single = dataclasses.replace(grid, format=FileFormat("plot3d", "float32"))
    body = {**BODY, "motion": [{"displace": ["0", "0", "0"]}]}
    meshes, moved = [md.prepare(wrapped(each, True), {"boundary": [body]}) for each in (grid, single)], []
    at = 1.2 * np.sin(meshes[0].points[:, [1, 0, 2]] + 1.0) * [1.0, 0.3, 0.0]
    for mesh in meshes:
        found = mesh.linearise(at, steps=1)
        assert found.exact, found.reason
        assert found.step.repair.converged
        moved.append(np.concatenate([block.ravel() for block in found.jvp(np.cos(3.0 * at[:, :2]))]))
    assert 0.0 < np.abs(moved[0] - moved[1]).max() < 1e-4 * np.abs(moved[0]).max()
    monkeypatch.setattr(untangle, "_CONVERGING", 2)
    found = meshes[1].linearise(1.01 * at, steps=1)
    assert not found.step.repair.converged
    assert not found.exact
    assert found.reason == (
        "the grid was repaired, but is not the minimum of the repair's energy; "
        "the derivative is that of the method before the repair"
    )
    assert mesh.linearise(1.01 * at, steps=1, repair="off").exact


@pytest.mark.parametrize("plane", [False, True])
def test_gradients_of_quality(plane):
    """Those of the core, as arrays like the blocks."""
    grid = frame_2d(5) if plane else frame(3, 2)
    body = {**BODY, "motion": [{"rotate": {"angle": 6, "axis": [0, 0, 1]}}]}
    step = md.prepare(md.Grid([b.copy() for b in wrapped(grid, plane).blocks]), {"boundary": [body]}).deform()
    core, topology = step.result.grid, step.result.setup.topology
    for given in (("volume",), ("scaled_jacobian_min", 40.0, [2, 0])):
        found = step.quality_gradient(*given)
        value, gradient = quality_gradient(core, core.points, topology, *(*given, 100.0)[: max(2, len(given))])
        assert found.value == value
        for block, part in enumerate(found.blocks):
            assert part.shape == step.grid.blocks[block].shape
            np.testing.assert_array_equal(part, core.block(block, gradient)[..., : part.shape[-1]].reshape(part.shape))
