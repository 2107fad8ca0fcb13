"""Gradients of quality measures: central differences, the values of the report, and refusals."""

import numpy as np
import pytest
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped

MEASURES = ("f_skew", "f_skew_min", "scaled_jacobian_min", "volume")


def bent(grid, plane=False):
    specs = {"name": "body", "select": ["*.i*", "*.j*"], "where": "abs(x) < 0.51 and abs(y) < 0.51", "kind": "moving"}
    motion = [{"rotate": {"angle": 6, "axis": [0, 0, 1]}}]
    # One block reversed: left-handed.
    blocks = [block.copy() for block in wrapped(grid, plane).blocks]
    blocks[0] = blocks[0][::-1].copy()
    return md.prepare(md.Grid(blocks), {"boundary": [{**specs, "motion": motion}]}).deform()


@pytest.fixture(scope="module", params=["3-D", "2-D"])
def step(request):
    return bent(frame()) if request.param == "3-D" else bent(frame_2d(5), plane=True)


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
    grid = wrapped(frame())
    body = {"name": "body", "select": ["*.i*", "*.j*"], "where": "abs(x) < 0.51 and abs(y) < 0.51", "kind": "moving"}
    motion = [{"displace": ["5.0", "0", "0"]}]
    mesh = md.prepare(md.Grid([b.copy() for b in grid.blocks]), {"boundary": [{**body, "motion": motion}]})
    crossed = mesh.deform(repair="off")
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
