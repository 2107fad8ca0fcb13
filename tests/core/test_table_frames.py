"""Hints on tables in another unit or frame; the wall that a table fits; the two sides of thin bodies."""

import re

import numpy as np
import pytest
from grids import frame

from meshdeform_core.boundary.classification import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import (
    Follow,
    Motion,
)
from meshdeform_core.boundary.tables import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, other_frame
from meshdeform_core.deform import Case, set_up
from meshdeform_core.errors import MotionError
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.numerics.geometry.local_spline import local_spline
from meshdeform_samples import generate

GRID, TABLES = generate("wing", 8)
TOPOLOGY = find_topology(GRID)
NODES = BoundaryNodes.of_quads(GRID, TOPOLOGY, select_quads(GRID, TOPOLOGY, ["wing"], "wing"))
TABLE = TABLES["structure.npz"]
# An asymmetric part of the structural model, so that no two frames fit alike.
POINTS = TABLE.points[TABLE.points[:, 2] > 0.005]

FRAMES = {
    "shifted": (POINTS + [5.0, -3.0, 2.0], "shifted by .*another origin"),
    "millimetres": (POINTS * 1e3, r"multiplied by 0.001, 100% .*in millimetres where the grid is in metres"),
    "inches": (POINTS / 0.0254, r"multiplied by 0.0254, 100% .*in inches where the grid is in metres"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_the_frame_that_fits_is_named(name):
    points, message = FRAMES[name]
    hint = other_frame(points, NODES)
    assert re.search(message, hint), hint


def test_nothing_is_proposed_for_points_that_fit_nowhere():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 3))
    assert "would lie on the nodes" not in other_frame(points, NODES)


def on_table_alone(data: SurfaceData, how: str = AUTOMATIC):
    motion = Motion((Follow(data, Matching(how, partial=True)),), {})
    return set_up(GRID, Case((BoundarySpec("table", ("*",), Kind.MOVING, None, motion),))).boundary


def test_a_table_alone_moves_the_wall_that_it_fits():
    boundary = on_table_alone(TABLE)
    (match,) = boundary.movers[0][1].matches
    assert match.matching.walls == ("wing",)
    assert match.how == "interpolate"
    assert set(boundary.movers[0][0]) == set(NODES.numbers)


def test_a_table_of_the_nodes_is_matched_to_the_nodes():
    data = SurfaceData(NODES.points, np.full_like(NODES.points, 0.01), np.empty((0, 3), dtype=np.int64), "nodes.csv")
    (match,) = on_table_alone(data).movers[0][1].matches
    assert match.how == "nearest"
    assert match.matched.sum() == len(NODES.numbers)


def test_the_shift_of_a_table_of_a_part_of_the_wall_is_told():
    """The middle of the part is not that of the wall, and the far field is among the faces that it may lie on."""
    part = NODES.points[NODES.points[:, 1] > 0.6] + [7.0, -30.0, 2.0]
    data = SurfaceData(part, 0.01 + 0.0 * part, np.empty((0, 3), dtype=np.int64), "part.csv")
    with pytest.raises(MotionError, match=r"shifted by \(-7, 30, -2\), 100% of its points would lie on the nodes"):
        on_table_alone(data)


def test_a_coarse_table_moves_all_sides_of_the_wall():
    """Its points lie at the edges of the body, where they are as near to one side as to the next."""
    ring = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    points = np.array([(x, y, z) for z in (0.0, 1.0) for x, y in ring])
    quads = np.array([(n, (n + 1) % 4, (n + 1) % 4 + 4, n + 4) for n in range(4)])
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    data = SurfaceData(points, 0.01 + 0.0 * points, halves, "coarse.csv")
    grid = frame(2, 2)
    motion = Motion((Follow(data, Matching("interpolate", partial=True)),), {})
    case = Case((BoundarySpec("table", ("*",), Kind.MOVING, None, motion), BoundarySpec("rest", ("*",), Kind.SLIP)))
    setup = set_up(grid, case)
    nodes = setup.boundary.movers[0][0]
    body = np.abs(grid.points[setup.topology.first][:, :2]).max(axis=1) < 0.51
    assert set(nodes) >= set(np.flatnonzero(body))


def plate(gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of both sides of a plate, staggered, with displacements in opposite directions, and normals."""
    sides = []
    for sign, shift in ((1.0, 0.0), (-1.0, 0.03)):
        x, z = np.meshgrid(np.linspace(-0.02, 1.02, 14) + shift, np.linspace(-0.02, 0.52, 8), indexing="ij")
        points = np.stack([x.ravel(), np.full(x.size, sign * gap / 2), z.ravel()], axis=-1)
        sides.append((points, opening(points[:, 0], sign), np.tile([0.0, -sign, 0.0], (len(points), 1))))
    return tuple(np.concatenate(parts) for parts in zip(*sides, strict=True))


def opening(x: np.ndarray, sign: float) -> np.ndarray:
    return np.stack([0 * x, 0.1 * x**2 + sign * 0.1 * np.sin(np.pi * x), 0 * x], axis=-1)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-5])
def test_the_sides_of_a_thin_body_are_told_apart(gap):
    points, displacement, normals = plate(gap)
    x, z = np.meshgrid(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 0.5, 6), indexing="ij")
    upper = np.stack([x.ravel(), np.full(x.size, gap / 2), z.ravel()], axis=-1)
    facing = np.tile([0.0, -1.0, 0.0], (len(upper), 1))
    moved, _ = local_spline(points, displacement, upper, normals=(normals, facing))
    assert np.abs(moved - opening(upper[:, 0], 1.0)).max() < 1e-3
    mixed, _ = local_spline(points, displacement, upper)
    assert np.abs(mixed - opening(upper[:, 0], 1.0)).max() > 1e-2


def test_sides_that_move_alike_are_used_together():
    points, _, normals = plate(1e-2)
    displacement = np.stack([0 * points[:, 0], 0.1 * points[:, 0] ** 2, 0 * points[:, 0]], axis=-1)
    targets = np.array([[0.31, 0.005, 0.22], [0.0, 0.005, 0.0]])
    facing = np.tile([0.0, -1.0, 0.0], (2, 1))
    one, _ = local_spline(points, displacement, targets, normals=(normals, facing))
    both, _ = local_spline(points, displacement, targets)
    assert (one == both).all()
