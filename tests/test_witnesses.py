"""The verdict against MFEM and OpenFOAM, where they are installed; see studies/witnesses.py."""

import sys
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.deform import Timing, impose
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess
from meshdeform_samples import load
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

pytestmark = pytest.mark.slow
sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))
witnesses = pytest.importorskip("witnesses", reason="the studies are not part of the source distribution")

mfem = pytest.mark.skipif(not witnesses.has_mfem(), reason="MFEM is not installed")
check_mesh = pytest.mark.skipif(not witnesses.has_check_mesh(), reason="OpenFOAM is not installed")


@pytest.fixture(scope="module")
def turned():
    """The splitter plate at 60 degrees: undeformed, in one step, and repaired."""
    setup = prepare_sample(
        Sample("splitter-plate", load("splitter-plate").SIZES["small"], constants=(("angle", 60.0),))
    )
    plain = impose(setup.with_repair("off"), setup.motion(0.0), 1, "float64", Timing())
    return setup, plain, impose(setup, setup.motion(0.0), None, "float64", Timing())


@mfem
def test_same_cells_are_invalid_by_mfem(turned):
    setup, plain, final = turned
    before = witnesses.determinants(plain.grid, setup.grid)
    assert (before.sampled <= 0).sum() == plain.assessment.after.invalid_cells > 100
    assert final.valid
    assert witnesses.determinants(final.grid, setup.grid).bound.min() > 0


@mfem
@pytest.mark.parametrize("spread", [0.2, 0.4])
@pytest.mark.parametrize("left", [False, True])
def test_distorted_cubes_by_mfem(spread, left):
    # Every cube stands alone, so that cells are invalid at corners, and between them only.
    random = np.random.default_rng(7)
    cube = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1)
    cubes = [(cube[::-1] if left else cube) + (3.0 * n, 0.0, 0.0) for n in range(400)]
    before = Grid.from_blocks(cubes)
    after = Grid.from_blocks([c + spread * random.standard_normal(c.shape) for c in cubes])
    found = witnesses.determinants(after, before)
    verdict = assess(Original(before, find_topology(before)), after.points, None).after
    # Where samples are positive and a bound is not, MFEM leaves the verdict open.
    low, high = (found.sampled <= 0).sum(), (found.bound <= 0).sum()
    assert 0 < low <= verdict.invalid_cells <= high < 400
    assert high - low <= 4


@check_mesh
def test_check_mesh_agrees(turned):
    _, plain, final = turned
    assert witnesses.check_mesh(final.grid) == "0 / 0"
    # Faces between cells that are all wrong alike have no wrong orientation: fewer than invalid cells.
    assert int(witnesses.check_mesh(plain.grid).split(" / ")[0]) > 0.25 * plain.assessment.after.invalid_cells > 0
