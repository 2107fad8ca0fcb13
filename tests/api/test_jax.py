"""The deformation inside JAX programs: values, both derivatives, jit, vmap, and what is refused."""

import numpy as np
import pytest
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped

jax = pytest.importorskip("jax")
from meshdeform.jax import deform_function  # noqa: E402
from meshdeform_core.deform import impose  # noqa: E402

BODY = {"body": ["block2.imax", "block4.jmax", "block5.jmin", "block7.imin"]}


@pytest.fixture(autouse=True)
def _double():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture(scope="module")
def mesh():
    blocks = [np.array(block) for block in wrapped(frame(2, 1)).blocks]
    return md.prepare(md.Grid(blocks), moving=BODY, slip={"span": ["*.kmin", "*.kmax"]})


def bend(mesh):
    return 0.05 * np.sin(mesh.points[:, [1, 0, 2]] + 1.0) * [1.0, 1.0, 0.0]


def cost(blocks):
    return sum((block**3).sum() for block in blocks)


def test_values_are_those_of_the_mesh(mesh):
    found = jax.jit(deform_function(mesh))(bend(mesh))
    expected = mesh.deform(bend(mesh), repair="off").grid.blocks
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["plain", "jit"])
def test_both_derivatives_against_differences(mesh, wrap):
    at, h = bend(mesh), 1e-6
    change = np.cos(3.0 * mesh.points)
    ends = [cost(mesh.deform(at + s * h * change, repair="off").grid.blocks) for s in (1, -1)]
    expected = (ends[0] - ends[1]) / (2 * h)
    backward, onward = deform_function(mesh), deform_function(mesh, "forward")
    gradient = wrap(jax.grad(lambda d: cost(backward(d))))(at)
    assert float((gradient * change).sum()) == pytest.approx(expected, rel=1e-7)
    value, slope = wrap(lambda d, c: jax.jvp(lambda x: cost(onward(x)), (d,), (c,)))(at, change)
    assert float(value) == pytest.approx(cost(backward(at)))
    assert float(slope) == pytest.approx(expected, rel=1e-7)


def test_several_displacements(mesh):
    both = np.stack([bend(mesh), 2.0 * bend(mesh)])
    found = jax.vmap(jax.grad(lambda d: cost(deform_function(mesh)(d))))(both)
    one = jax.grad(lambda d: cost(deform_function(mesh)(d)))(both[1])
    np.testing.assert_allclose(found[1], one, rtol=1e-12)


def test_plane_grid():
    grid = md.Grid([np.array(block) for block in wrapped(frame_2d(3), True).blocks])
    mesh = md.prepare(grid, moving=BODY)
    gradient = jax.grad(lambda d: cost(deform_function(mesh)(d)))(np.zeros(mesh.points.shape))
    assert gradient.shape == mesh.points.shape
    assert not np.any(gradient[:, 2])
    plane = jax.grad(lambda d: cost(deform_function(mesh)(d)))(np.zeros((len(mesh.points), 2)))
    np.testing.assert_array_equal(plane, gradient[:, :2])
    onward = deform_function(mesh, "forward")
    slope = jax.jvp(onward, (np.zeros(plane.shape),), (np.ones(plane.shape),))[1]
    assert [each.shape for each in slope] == [block.shape for block in mesh.grid.blocks]


def test_a_value_and_its_gradient_deform_once(mesh, monkeypatch):
    made = []
    monkeypatch.setattr("meshdeform.mesh.impose", lambda *given: made.append(1) or impose(*given))
    value, _ = jax.value_and_grad(lambda d: cost(deform_function(mesh)(d)))(bend(mesh))
    assert float(value) == pytest.approx(cost(mesh.deform(bend(mesh), repair="off").grid.blocks))
    assert len(made) == 2


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["plain", "jit"])
def test_an_invalid_grid_is_the_same_error_everywhere(mesh, wrap):
    with pytest.raises(jax.errors.JaxRuntimeError, match=r"GridError: .*INVALID.*first cell"):
        jax.block_until_ready(wrap(deform_function(mesh))(mesh.points * [-2.0, 0.0, 0.0]))


def test_an_inexact_derivative_is_a_warning(mesh, monkeypatch):
    monkeypatch.setattr(type(mesh.linearise()), "exact", False)
    with pytest.warns(UserWarning, match="not that of the grid"):
        jax.grad(lambda d: cost(deform_function(mesh)(d)))(bend(mesh))


def test_what_is_refused(mesh):
    with pytest.raises(md.MethodError, match="expected 'reverse' or 'forward'"):
        deform_function(mesh, "both")
    with pytest.raises(md.MethodError, match=r"like mesh\.points"):
        deform_function(mesh)(np.zeros((3, 3)))
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(md.MethodError, match="jax_enable_x64"):
        deform_function(mesh)(bend(mesh))
