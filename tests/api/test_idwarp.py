"""``meshdeform.compat.idwarp``: the calls of solvers and scripts, and derivatives against differences."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from grids import polar
from solver_stub import Solver

import meshdeform as md
from meshdeform.compat.idwarp import MultiUSMesh, USMesh
from meshdeform.compat.options import NOTES, Options
from meshdeform.grid import wrapped
from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_core.wording import vector

H = 1e-6


@pytest.fixture(scope="module")
def wing(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("idwarp") / "wing.cgns")
    md.write(md.sample("wing", 8).grid, path)
    return path


@pytest.fixture(scope="module")
def mesh(wing):
    return USMesh({"gridFile": wing, "EVALMODE": "exact"})


@pytest.fixture
def overset(tmp_path):
    """Two O-grids that overlap, the first in two zones, and a box around them."""
    blocks, patches = [], []
    ring = polar(12, 5, 2).block(0)
    box = np.stack(np.meshgrid(*[np.linspace(-6, 6, 4)] * 2, np.linspace(0, 1, 3), indexing="ij"), axis=-1)
    names = ["wing.00001", "wing.00002", "flap.00001", "back.00001"]
    for block in (ring[:7], ring[6:], ring + [2.0, 0.5, 0.0], box):
        blocks.append(np.ascontiguousarray(block))
    for zone in range(3):
        ni, nj, nk = blocks[zone].shape[:3]
        patches.append(Patch(f"w{zone}", (Window(zone, Side.JMIN, (0, 0), (ni - 1, nk - 1)),), "wall", "BCWallViscous"))
        for side in (Side.KMIN, Side.KMAX):
            patches.append(Patch("sym", (Window(zone, side, (0, 0), (ni - 1, nj - 1)),), "sym", "BCSymmetryPlane"))
    path = tmp_path / "overset.cgns"
    md.write(wrapped(Grid.from_blocks(blocks, names, patches=tuple(patches))), path)
    return str(path)


def bend(points, size=0.05):
    """A smooth motion that keeps the symmetry plane of the wing, y = 0."""
    return points + size * points[:, 1:2] ** 2 * [0.3, 0.0, 1.0]


def differences(mesh, change, grid):
    at = mesh.getSurfaceCoordinates()
    ends = []
    for step in (H, -H):
        mesh.setSurfaceCoordinates(at + step * change)
        mesh.warpMesh()
        ends.append(grid())
    mesh.setSurfaceCoordinates(at)
    mesh.warpMesh()
    return (ends[0] - ends[1]) / (2 * H)


@pytest.mark.parametrize("always", [False, True], ids=["where it pays", "always"])
def test_derivatives_at_the_undeformed_grid(wing, always, monkeypatch):
    """What IDWarp's pull request 111 asks for: no deformation first, and the motion itself as the reference."""
    if always:
        # Fast sums pay on larger grids only.
        chosen = Options.method_of
        monkeypatch.setattr(Options, "method_of", lambda *given: dataclasses.replace(chosen(*given), summation="fast"))
    mesh = USMesh({"gridFile": wing, "errTol": 0.0005, "evalMode": "fast", "symmTol": 1e-6, "bucketSize": 8})
    start = mesh.getSurfaceCoordinates()
    random = np.random.default_rng(314)
    change = random.random(start.shape) - 0.5
    for at in (bend(start), start):
        mesh.setSurfaceCoordinates(at)
        mesh.warpMesh()
        found = mesh.warpDerivFwd(change, solverVec=False)
        expected = differences(mesh, change, mesh.getWarpGrid)
        assert np.linalg.norm(found - expected) < 1e-5 * np.linalg.norm(expected)
    weights = random.random(expected.shape) - 0.5
    assert mesh.warpDeriv(weights, solverVec=False) is None
    product = float(weights @ expected)
    assert abs(product - (mesh.getdXs() * change).sum()) < 1e-5 * abs(product)


def test_sequence_of_a_solver(wing):
    solver, mesh = Solver.of(wing), USMesh(options={"gridFile": wing}, comm=None)
    solver.set_mesh(mesh)
    np.testing.assert_array_equal(mesh.getSolverGrid().reshape(-1, 3), solver.start)
    moved = bend(solver.points)
    mesh.setSurfaceCoordinates(moved)
    mesh.warpMesh()
    np.testing.assert_array_equal(mesh.getSurfaceCoordinates(), moved)
    grid = mesh.getSolverGrid().reshape(-1, 3)
    np.testing.assert_array_equal(grid[solver.wall_of], moved)
    assert np.abs(grid - solver.start).max() >= np.abs(moved - solver.points).max()
    # Nodes of two pieces stay together.
    _, first, number = np.unique(solver.indices[::3], return_index=True, return_inverse=True)
    np.testing.assert_array_equal(grid, grid[first][number])
    random = np.random.default_rng(1)
    weights = random.standard_normal(mesh.warp.griddata.solvermeshdof)
    change = random.standard_normal(moved.shape)
    mesh.warpDeriv(weights)
    pushed = mesh.warpDerivFwd(change.ravel())
    assert weights @ pushed == pytest.approx((mesh.getdXs() * change).sum(), rel=1e-11)
    # Copies of a point move alike, as those of a parametrised surface do.
    smooth = np.sin(moved[:, [1, 2, 0]])
    expected = differences(mesh, smooth, mesh.getSolverGrid)
    np.testing.assert_allclose(mesh.warpDerivFwd(smooth), expected, atol=1e-6 * np.abs(expected).max())


def test_written_grid(mesh, wing, tmp_path):
    start = mesh.getSurfaceCoordinates()
    mesh.setSurfaceCoordinates(bend(start))
    mesh.warpMesh()
    mesh.writeGrid(str(tmp_path / "moved.cgns"))
    moved = md.read(tmp_path / "moved.cgns")
    flat = np.concatenate([block.transpose(2, 1, 0, 3).ravel() for block in moved.blocks])
    np.testing.assert_array_equal(flat, mesh.getCommonGrid())
    assert moved.patches == md.read(wing).patches
    mesh.setSurfaceCoordinates(start)


def test_plot3d_and_surface_files(tmp_path):
    ring = polar(12, 5, 2)
    md.write(wrapped(ring), tmp_path / "ring.xyz")
    wall = md.Grid([ring.block(0)[a:b, :1] for a, b in ((0, 5), (4, 9), (8, 13))])
    md.write(wall, tmp_path / "wall.xyz")
    wider = [1.1, 1.1, 1.0]
    md.write(md.Grid([wider * block for block in wall.blocks]), tmp_path / "wider.xyz")
    given = {"gridFile": str(tmp_path / "ring.xyz"), "fileType": "plot3d"}
    for options, message in (
        (given, "symmetryPlanes is missing"),
        ({**given, "fileType": "CGNS"}, "type plot3d; .* is 'CGNS'"),
    ):
        with pytest.raises(md.CaseError, match=message):
            USMesh(options)
    mesh = USMesh({**given, "symmTol": 2e-3, "symmetryPlanes": [[[0, 0, 1e-3], [0, 0, 1]], [[0, 0, 1.001], [0, 0, 3]]]})
    with pytest.raises(md.CaseError, match="declares no wall"):
        mesh.getSurfaceCoordinates()
    with pytest.raises(md.MotionError, match=r"block 1 has \(13, 6, 3\) nodes; expected a surface"):
        mesh.setSurfaceDefinitionFromFile(str(tmp_path / "ring.xyz"))
    mesh.setSurfaceDefinitionFromFile(str(tmp_path / "wall.xyz"))
    order = np.concatenate([block[:, 0].transpose(1, 0, 2).reshape(-1, 3) for block in wall.blocks])
    np.testing.assert_allclose(mesh.getSurfaceCoordinates(), order)
    mesh.setSurfaceFromFile(str(tmp_path / "wider.xyz"))
    np.testing.assert_allclose(mesh.getSurfaceCoordinates(), wider * order)
    mesh.warpMesh()
    assert np.ptp(mesh.getWarpGrid().reshape(-1, 3)[:, 2]) == pytest.approx(1.0, abs=1e-12)
    mesh.writeGrid()
    after = md.read(tmp_path / "ring_warped.xyz").blocks[0]
    np.testing.assert_array_equal(after.transpose(2, 1, 0, 3).ravel(), mesh.getCommonGrid())


def test_components_move_together(overset):
    solver = Solver.of(overset)
    component = {"evalMode": "exact"}
    mesh = MultiUSMesh(overset, {"wing": {**component, "method": "idw-tfi"}, "flap": component})
    with pytest.raises(md.CaseError, match="setExternalMeshIndices"):
        mesh.setSurfaceDefinition(solver.points, solver.conn, solver.sizes)
    solver.set_mesh(mesh, zones=True)
    zone = np.searchsorted(mesh._grid.offsets, solver.indices[::3] // 3, side="right") - 1
    moved = solver.points.copy()
    flap = zone[solver.wall_of] == 2
    moved[flap] += [0.1, 0.2, 0.0]
    moved[~flap, :2] *= 1.05
    mesh.setSurfaceCoordinates(moved)
    mesh.warpMesh()
    grid = mesh.getSolverGrid().reshape(-1, 3)
    np.testing.assert_array_equal(grid[solver.wall_of], moved)
    np.testing.assert_array_equal(grid[zone == 3], solver.start[zone == 3])
    parts, count = mesh.getWarpGrid()
    assert (len(parts), count) == (2, sum(map(len, parts)))
    np.testing.assert_array_equal(np.concatenate(parts), mesh.getCommonGrid()[:count])
    random = np.random.default_rng(2)
    weights, change = random.standard_normal(grid.size), random.standard_normal(moved.shape) * [1, 1, 0]
    gradient = mesh.warpDeriv(weights)
    np.testing.assert_array_equal(gradient, mesh.getdXs())
    assert weights @ mesh.warpDerivFwd(change) == pytest.approx((gradient * change).sum(), rel=1e-11)


def test_walls_are_chosen_by_type_or_name_and_stand_in_the_order_of_the_file(overset):
    mesh = MultiUSMesh(overset, {"flap": {"specifiedSurfaces": ["W2"]}, "WING": {}})
    grid, start, before = md.read(overset), mesh.getSurfaceCoordinates(), mesh.getWarpGrid()[0]
    assert {"w0", "w1", "w2", "wall", "sym"} < set(grid.patches)
    for points, walls in ((start[:36], grid.blocks[:2]), (start[36:], grid.blocks[2:3])):
        known = np.concatenate([block[:, 0].reshape(-1, 3) for block in walls])
        np.testing.assert_array_equal(np.unique(points, axis=0), np.unique(known, axis=0))
    shift = np.repeat([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0]], 36, axis=0)
    mesh.setSurfaceCoordinates((start + shift).ravel())
    mesh.warpMesh()
    for part, old, by in zip(mesh.getWarpGrid()[0], before, shift[::36], strict=True):
        np.testing.assert_allclose(part, old + np.tile(by, len(old) // 3), rtol=0, atol=1e-12)
    mesh.setSurfaceCoordinates(np.where(shift[:, :1] > 0.0, [4.0, 0.0, 0.0] + start * [-1.0, 1.0, 1.0], start))
    with pytest.warns(UserWarning, match="the warped grid of component 2 is invalid: Step.INVALID.*; first Inv"):
        mesh.warpMesh()
    with pytest.raises(md.CaseError, match="no family 'tail'; expected some of sym, wall"):
        MultiUSMesh(overset, {"flap": {"specifiedSurfaces": ["wall", "tail"]}}).getSurfaceCoordinates()


def test_triangles_are_faces_and_the_same_faces_of_two_components_are_told_apart_by_zones(tmp_path):
    """The bottom of a quarter of a cylinder, whose inner faces end at its axis."""
    angle, radius, height = np.meshgrid(*(np.linspace(0, *ends) for ends in ((1.5, 5), (1, 4), (1, 3))), indexing="ij")
    block = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    md.write(md.Grid([block, block], ["one.1", "two.1"]), tmp_path / "both.cgns")
    mesh = MultiUSMesh(str(tmp_path / "both.cgns"), {"one": {}, "two": {}})
    mesh.setExternalMeshIndices(np.arange(6 * 5 * 4 * 3))
    points, node = block[:, :, 0].reshape(-1, 3)[1:], np.arange(-1, 19).reshape(5, 4)
    quads = np.stack([node[:-1, 1:-1], node[1:, 1:-1], node[1:, 2:], node[:-1, 2:]], axis=-1)
    conn = np.concatenate([quads.ravel(), np.stack([node[1:, 0], node[1:, 1], node[:-1, 1]], axis=-1).ravel()])
    sizes = [4] * 8 + [3] * 4
    with pytest.raises(md.GridError, match="12 of 12 faces of the surface lie on several components"):
        mesh.setSurfaceDefinition(points, conn, sizes)
    mesh.setSurfaceDefinition([*points, *points], [*conn, *(conn + 19)], sizes * 2, [1] * 12 + [2] * 12)
    start, shift = mesh.getSolverGrid().reshape(2, -1, 3), [[[0.0, 0.0, 0.0]], [[0.1, 0.2, 0.3]]]
    mesh.setSurfaceCoordinates(np.add([points, points], shift))
    mesh.warpMesh()
    np.testing.assert_allclose(mesh.getSolverGrid().reshape(2, -1, 3), start + shift, rtol=0, atol=1e-12)
    for call, given, message in (
        (mesh.setSurfaceCoordinates, points, r"have the shape \(19, 3\); expected \(38, 3\)"),
        (mesh.setSurfaceCoordinates, np.full((38, 3), np.nan), "not finite"),
        (mesh.warpDerivFwd, points, "dXs has 57 values; expected 114"),
        (mesh.warpDeriv, points, "dXv has 57 values; expected 360"),
    ):
        with pytest.raises(md.MeshDeformError, match=message):
            call(given)


def test_components_that_stay(overset):
    solver = Solver.of(overset)
    mesh = MultiUSMesh(overset, {"flap": {}})
    solver.set_mesh(mesh, zones=True)
    moved = solver.points + [[0.1 * (n == 5), 0.0, 0.0] for n in range(len(solver.points))]
    mesh.setSurfaceCoordinates(moved)
    with pytest.raises(md.MotionError) as told:
        mesh.warpMesh()
    where = f"the first to {vector(moved[5])}; expected points that stay"
    assert f"1 surface points moved that lie on zones without options, {where}" in str(told.value)
    with pytest.raises(md.CaseError, match="no zone of component 'tail'"):
        MultiUSMesh(overset, {"tail": {}})
    with pytest.raises(md.CaseError, match="dtype"):
        MultiUSMesh(overset, {"flap": {}}, dtype="D")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (None, "options = None"),
        ({"gridFile": "g.cgns", "aEx": 3.0}, "did you mean 'aExp'"),
        ({}, "gridFile = None"),
        ({"gridFile": "g.cgns", "GridFile": "h.cgns"}, "found both 'gridFile' and 'GridFile'"),
        ({"gridFile": "g", "fileType": "OpenFOAM"}, "unstructured"),
        ({"gridFile": "g.cgns", "alpha": -1.0}, "alpha = -1.0"),
        ({"gridFile": "g.cgns", "useRotations": 1}, "useRotations"),
        ({"gridFile": "g.cgns", "specifiedSurfaces": "wing"}, "list of family names"),
        ({"gridFile": "g.cgns", "symmetryPlanes": [[0, 0, 1]]}, "symmetryPlanes"),
        ({"gridFile": "g.cgns", "method": "magic"}, "magic"),
    ],
)
def test_options_that_are_refused(given, message):
    with pytest.raises(md.MeshDeformError, match=message):
        USMesh(given)


def test_options_are_honoured(wing, capsys):
    given = {"gridFile": wing, "SPECIFIEDsurfaces": ["WING"], "aexp": 2.0, "bExp": 4.0, "ldeffact": 50}
    given |= {"useRotations": False, "zeroCornerRotations": False, "evalMode": "EXACT", "errTol": 1e-6, "repair": "OFF"}
    mesh = USMesh(given)
    assert mesh.getOption("AEXP") == 2.0
    mesh.setOption("alpha", 0.3)
    mesh.getSurfaceCoordinates()
    part = mesh._components[0]._mesh.setup.case.method.idw
    reach = USMesh({"gridFile": wing})
    reach.getSurfaceCoordinates()
    usual = reach._components[0]._mesh.setup.case.method.idw
    assert (part.a, part.b, part.alpha, part.rotation) == (2.0, 4.0, 0.3, "none")
    assert (part.smoothing, part.summation) == (0, "exact")
    assert (usual.a, usual.b, usual.alpha, usual.rotation, usual.smoothing) == (3, 5, 0.25, "lie", "auto")
    nodes = np.unique(np.concatenate([block.reshape(-1, 3) for block in md.read(wing).blocks]), axis=0)
    length = np.linalg.norm(reach.getSurfaceCoordinates() - nodes.mean(axis=0), axis=1).max()
    assert (usual.length, part.length) == pytest.approx((length, 50 * length))
    assert (part.summation_tolerance, usual.summation_tolerance) == (1e-8, 5e-7)
    with pytest.raises(md.CaseError, match="after the surface"):
        mesh.setOption("alpha", 0.1)
    with pytest.warns(UserWarning, match="cornerAngle = 60 has no effect: edges are sharp from about 50"):
        USMesh({"gridFile": wing, "cornerAngle": 60})
    mesh.printOptions()
    told = capsys.readouterr().out
    assert "aExp                 2.0\nbExp                 4.0\n" in told
    assert f"errTol               1e-06  ({NOTES['errTol']})\n" in told


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: {"points": s.points + 0.01}, "not faces on the outside"),
        (lambda s: {"conn": s.conn[:-1]}, "conn has"),
        (lambda s: {"conn": s.conn + 10**6}, "rows of pts"),
        (lambda s: {"conn": s.conn - 1}, "conn has -1 to .*; expected 0 to"),
        (lambda s: {"sizes": np.append(s.sizes[:-5], [5] * 4), "zones": s.zones[:-1]}, "faces of 3 or 4 corners"),
        (lambda s: {"indices": s.indices - 3}, "of the nodes -1 to"),
        (lambda s: {"indices": s.indices[::-1]}, "x, y, z"),
        (lambda s: {"indices": s.indices + 3 * 10**6}, "numbered from 0"),
        (lambda s: {"zones": s.zones[:-1]}, "cgnsBlockIDs"),
        (lambda s: {"conn": s.conn[:400], "sizes": s.sizes[:100], "zones": s.zones[:100]}, None),
    ],
)
def test_surfaces_that_are_refused(wing, spoil, message):
    solver = Solver.of(wing)
    vars(solver).update(spoil(solver))
    mesh = USMesh({"gridFile": wing})
    if message is None:
        # Part of the wall: the rest is free, and points outside of the faces must not move.
        solver.set_mesh(mesh)
        mesh.setSurfaceCoordinates(bend(solver.points))
        with pytest.raises(md.MotionError, match="stay"):
            mesh.warpMesh()
        return
    with pytest.raises(md.MeshDeformError, match=message):
        solver.set_mesh(mesh, zones=True)


def test_copies_that_disagree(wing):
    solver, mesh = Solver.of(wing), USMesh({"gridFile": wing})
    solver.set_mesh(mesh)
    _, first, count = np.unique(solver.points.round(9), axis=0, return_index=True, return_counts=True)
    at = first[np.argmax(count > 1)]
    moved = solver.points.copy()
    moved[at] += 1e-4
    mesh.setSurfaceCoordinates(moved)
    away = np.linalg.norm(solver.start - solver.points[at], axis=1)
    apart = np.sqrt(3) * 1e-4 / away[away > 1e-9].min()
    with pytest.warns(
        UserWarning, match=f"copies of surface points are up to {apart:.3g} edges apart; they get their mean"
    ):
        mesh.warpMesh()
    copies = np.linalg.norm(solver.points - solver.points[at], axis=1) < 1e-9
    np.testing.assert_allclose(mesh.getSolverGrid().reshape(-1, 3)[solver.wall_of[at]], moved[copies].mean(axis=0))
    moved[at] += 1.0
    mesh.setSurfaceCoordinates(moved)
    with pytest.raises(md.MotionError, match="copies"):
        mesh.warpMesh()


def test_without_mpi4py(wing):
    """In serial nothing needs it."""
    code = (
        "import sys; sys.modules['mpi4py'] = None; from meshdeform.compat.idwarp import USMesh; "
        "mesh = USMesh({'gridFile': sys.argv[1]}); mesh.warpMesh(); print(len(mesh.getSurfaceCoordinates()))"
    )
    done = subprocess.run([sys.executable, "-c", code, wing], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 100
