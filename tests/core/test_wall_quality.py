"""Moving and fixed walls in the report: a channel with a bump whose roof is lowered."""

import numpy as np
import pytest
from cases import constant, formulas

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Options
from meshdeform_core.quality.lines import LAYERS


def channel(ni: int = 41, nj: int = 25, clustering: float = 2.5) -> Grid:
    """A plane channel of height 1 with a bump at its floor; cells cluster at floor and roof."""
    x = np.linspace(-2.0, 2.0, ni)
    s = np.linspace(-1.0, 1.0, nj)
    share = 0.5 * (1.0 + np.tanh(clustering * s) / np.tanh(clustering))
    floor = 0.3 * np.exp(-((x / 0.4) ** 2))
    y = floor[:, None] + (1.0 - floor[:, None]) * share
    return Grid.from_blocks([np.stack([np.tile(x[:, None], (1, nj)), y, 0 * y], axis=-1)[:, :, None]])


def case(method: str, motion) -> Case:
    return Case(
        (
            BoundarySpec("roof", ("block1.jmax",), Kind.MOVING, None, motion),
            BoundarySpec("floor", ("block1.jmin",), Kind.FIXED),
        ),
        method=Options(method),
    )


def lines_at_floor(points: np.ndarray, layer: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the first lines at the floor of a block (ni, nj, 2), and the wall-normal distance of a layer."""
    tangent = np.diff(points[:, 0], axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    mean = np.zeros((len(points), 2))
    mean[:-1] += normal
    mean[1:] += normal
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    first, far = points[:, 1] - points[:, 0], points[:, layer] - points[:, 0]
    angle = np.degrees(
        np.arctan2(np.abs(mean[:, 0] * first[:, 1] - mean[:, 1] * first[:, 0]), np.einsum("ni,ni->n", mean, first))
    )
    return angle, np.einsum("ni,ni->n", mean, far)


@pytest.mark.parametrize("method", ["tfi", "idw-tfi"])
def test_fixed_walls_are_measured(method):
    grid = channel()
    result = deform(grid, case(method, formulas("0", "-0.4*exp(-6*x*x)", "0")))
    walls = result.assessment.after.walls
    before, after = (g.block(0)[:, :, 0, :2] for g in (grid, result.grid))
    angle, _ = lines_at_floor(after, 1)
    fixed = walls["fixed"]
    assert fixed.wall_normal_deviation_deg.max == pytest.approx(angle.max(), rel=1e-10)
    assert fixed.wall_normal_deviation_deg.rms == pytest.approx(np.sqrt(np.mean(angle**2)), rel=1e-10)
    for layer, found in ((1, fixed.first_cell_height_ratio), (LAYERS, fixed.layer_thickness_ratio)):
        ratio = lines_at_floor(after, layer)[1] / lines_at_floor(before, layer)[1]
        assert (found.min, found.max) == pytest.approx((ratio.min(), ratio.max()), rel=1e-10)
    place = fixed.worst["wall_normal_deviation_deg"]
    assert place.value == fixed.wall_normal_deviation_deg.max
    assert place.ijk[1] == 1
    assert abs(place.ijk[0] - 1 - int(angle.argmax())) <= 1
    moving = walls["moving"]
    assert moving.wall_normal_deviation_deg == result.assessment.after.wall_normal_deviation_deg
    assert moving.first_cell_height_ratio == result.assessment.after.first_cell_height_ratio
    assert result.assessment.before.walls["fixed"].layer_thickness_ratio.min == 1.0


def test_far_field_is_no_wall():
    """Without clustered cells the lower side is a far field or unknown, and not measured."""
    grid = channel(clustering=1e-3)
    walls = deform(grid, case("tfi", constant(0, -0.1, 0))).assessment.after.walls
    assert walls["fixed"] is None
    assert walls["moving"] is not None
