"""``mesh.linearise``: shapes, errors, and when it is not the derivative of the step."""

import numpy as np
import pytest
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped

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


MEASURES = ("f_skew", "f_skew_min", "scaled_jacobian_min", "volume")


def bent(grid, plane=False):
    motion = [{"rotate": {"angle": 6, "axis": [0, 0, 1]}}]
    # One block reversed: left-handed.
    blocks = [block.copy() for block in wrapped(grid, plane).blocks]
    blocks[0] = blocks[0][::-1].copy()
    return md.prepare(md.Grid(blocks), {"boundary": [{**BODY, "motion": motion}]}).deform()


@pytest.fixture(scope="module", params=["3-D", "2-D"])
def step(request):
    return bent(frame(3, 2)) if request.param == "3-D" else bent(frame_2d(5), plane=True)


@pytest.mark.parametrize("measure", MEASURES)
def test_central_differences(step, measure):
    found, rng = step.quality_gradient(measure, sharpness=40.0), np.random.default_rng(2)
    core, topology = step.result.grid, step.result.setup.topology
    from meshdeform_core.quality.gradients import quality_gradient

    change = rng.standard_normal(core.points.shape)
    if core.dimension == 2:
        change[:, 2] = 0.0
    gradient = quality_gradient(core, core.points, topology, measure, 40.0)[1]
    told, size = (gradient * change).sum(), np.abs(gradient * change).sum()
    for block, part in enumerate(found.blocks):
        np.testing.assert_array_equal(part, core.block(block, gradient)[..., : part.shape[-1]].reshape(part.shape))
    errors = []
    for h in (1e-5, 2.5e-6):
        one, two = (quality_gradient(core, core.points + s * h * change, topology, measure, 40.0)[0] for s in (1, -1))
        errors.append(abs((one - two) / (2 * h) - told) / size)
    assert errors[1] < 1e-6
    assert errors[1] < errors[0] / 12 or errors[1] < 1e-9


def test_values_are_those_of_the_report(step):
    quality = step.report["quality"]["after"]
    assert step.quality_gradient("f_skew").value == pytest.approx(quality["f_skew"]["harmonic_mean"], rel=1e-6)
    assert step.quality_gradient("volume").value == pytest.approx(quality["total_volume"], rel=1e-12)
    for measure, smallest in (
        ("f_skew_min", quality["f_skew"]["min"]),
        ("scaled_jacobian_min", quality["min_scaled_jacobian"]),
    ):
        sharp, soft = (step.quality_gradient(measure, sharpness).value for sharpness in (1e6, 30.0))
        assert sharp == pytest.approx(smallest, abs=2e-5)
        assert soft <= sharp
        assert [g.shape for g in step.quality_gradient(measure).blocks] == [b.shape for b in step.grid.blocks]


def test_refusals(step):
    with pytest.raises(md.GridError, match="expected one of f_skew, f_skew_min"):
        step.quality_gradient("beauty")
    motion = [{"displace": ["5.0", "0", "0"]}]
    blocks = [block.copy() for block in wrapped(frame()).blocks]
    crossed = md.prepare(md.Grid(blocks), {"boundary": [{**BODY, "motion": motion}]}).deform(repair="off")
    assert not crossed.valid
    with pytest.raises(md.GridError, match=r"f_skew is zero in .* cells"):
        crossed.quality_gradient("f_skew")
    assert crossed.quality_gradient("scaled_jacobian_min").value < 0


def test_the_volume_of_some_blocks():
    step = bent(frame())
    each = [step.quality_gradient("volume", blocks=[b]) for b in range(len(step.grid.blocks))]
    whole = step.quality_gradient("volume")
    assert sum(found.value for found in each) == pytest.approx(whole.value, rel=1e-12)
    some = step.quality_gradient("volume", blocks=[2, 0])
    assert some.value == pytest.approx(each[0].value + each[2].value, rel=1e-12)
    assert some.blocks[0].any()
    assert not some.blocks[1].any()
    for blocks in ([], [-1], [99]):
        with pytest.raises(md.GridError, match="blocks = "):
            step.quality_gradient("volume", blocks=blocks)
