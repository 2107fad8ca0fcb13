"""Motions with tables of their own: boxes, rigid bodies, modes, airfoils; against closed forms and slow twins."""

from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.shapes import Outline
from meshdeform_core.boundary.tables import BoundaryNodes
from meshdeform_core.deform import set_up
from meshdeform_core.errors import FormatError, MotionError
from meshdeform_core.grid import FloatArray, Grid, Side
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats.case import case_of


def box_nodes() -> BoundaryNodes:
    axes = [np.linspace(-1, 1, n) for n in (5, 4, 6)]
    grid = Grid.from_blocks([np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)])
    topology = find_topology(grid)
    return BoundaryNodes.of_quads(grid, topology, np.flatnonzero(topology.external))


def moved(
    nodes: BoundaryNodes, step: dict, folder: Path = Path(), time: float = 0.0, fraction: float = 1.0
) -> FloatArray:
    case = case_of({"boundary": [{"select": ["*"], "motion": step}]}, folder).case
    (spec,) = case.boundaries
    assert spec.kind is Kind.MOVING
    return spec.motion.prepare(nodes).displacement(time, fraction)


FRAME = Rotation.from_euler("xyz", [20, -30, 50], degrees=True).as_matrix()
ORIGIN, EDGES = np.array([-0.4, -0.9, -0.8]), FRAME * np.array([[1.1], [1.7], [1.3]])
MOVES = [([2, 1, 2], [0.1, -0.2, 0.3]), ([3, 3, 2], [-0.3, 0.1, 0.05]), (["*", "*", 2], [0.0, 0.02, 0.0])]


def box(moves=MOVES) -> dict:
    entries = [{"at": at, "by": by} for at, by in moves]
    return {"ffd": {"origin": ORIGIN.tolist(), "edges": EDGES.tolist(), "points": [3, 4, 2], "move": entries}}


def bernstein_by_hand(x: np.ndarray, moves) -> np.ndarray:
    """One node and one control point after the other."""
    place = np.linalg.solve(EDGES.T, x - ORIGIN)
    if not ((place >= 0) & (place <= 1)).all():
        return np.zeros(3)
    total = np.zeros(3)
    for at, by in moves:
        choices = [range(n) if entry == "*" else [entry - 1] for entry, n in zip(at, (3, 4, 2), strict=True)]
        for ijk in ((i, j, k) for i in choices[0] for j in choices[1] for k in choices[2]):
            weight = 1.0
            for i, degree, u in zip(ijk, (2, 3, 1), place, strict=True):
                weight *= comb(degree, i) * u**i * (1 - u) ** (degree - i)
            total += weight * np.array(by)
    return total


def test_boxes_are_bernstein_polynomials_and_move_what_is_inside():
    nodes = box_nodes()
    found = moved(nodes, box())
    exact = np.array([bernstein_by_hand(x, MOVES) for x in nodes.points])
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14)
    inside = (exact != 0).any(axis=1)
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal(found[~inside], 0)
    np.testing.assert_allclose(moved(nodes, box(), fraction=0.5), 0.5 * exact, atol=1e-14)
    # All nodes are on the faces of a box around them, which belong to it.
    around = {"origin": [-1] * 3, "edges": np.diag([2, 2, 2]).tolist(), "points": [2, 2, 2]}
    found = moved(nodes, {"ffd": around | {"move": [{"at": ["*"] * 3, "by": [1, 2, 3]}]}})
    np.testing.assert_allclose(found, np.tile([1.0, 2.0, 3.0], (len(nodes.points), 1)), atol=1e-14)
    with pytest.raises(MotionError, match="no node of the boundary is in the box"):
        moved(nodes, {"ffd": {**box()["ffd"], "origin": [10, 0, 0]}})


def test_times_are_checked_before_a_series_starts(tmp_path):
    (tmp_path / "q.csv").write_text("t,q\n0,0\n1,1\n")
    grid = box_nodes().grid
    np.savetxt(tmp_path / "shape.csv", np.hstack([box_nodes().points] * 2), delimiter=",")
    step = {"modes": {"files": ["shape.csv"], "amplitudes": {"file": "q.csv"}}}
    setup = set_up(grid, case_of({"boundary": [{"motion": step}]}, tmp_path).case)
    with pytest.raises(MotionError, match=r"times from 0 to 1; t = 1\.5"):
        next(deform_series(setup, Schedule((0.5, 1.0, 1.5)), "float64"))
    step = box([([1, 1, 1], ["1/(t - 2)", 0, 0])])
    setup = set_up(grid, case_of({"boundary": [{"motion": step}]}).case)
    with pytest.raises(MotionError, match=r"control points '1/\(t - 2\)' is inf at t = 2"):
        next(deform_series(setup, Schedule((0.0, 1.0, 2.0)), "float64"))


def table(folder: Path, text: str) -> dict:
    (folder / "m.csv").write_text(text)
    return {"file": "m.csv"}


def test_angles_about_the_axes_of_the_body(tmp_path):
    step = {"rigid": {**table(tmp_path, "t,x,y,z,rx,ry,rz\n0,0,0,0,0,0,0\n2,2,0,4,20,40,60\n"), "order": "ZYX",
                      "center": [0.1, 0.2, 0.3]}}  # fmt: skip
    nodes = box_nodes()
    for time, fraction in ((1.0, 1.0), (2.0, 0.5)):
        turn = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True)
        exact = turn.apply(nodes.points - [0.1, 0.2, 0.3]) + [0.1, 0.2, 0.3] + [1, 0, 2] - nodes.points
        np.testing.assert_allclose(moved(nodes, step, tmp_path, time, fraction), exact, atol=1e-14)
    np.testing.assert_array_equal(moved(nodes, step, tmp_path, 0.0), 0)
    with pytest.raises(MotionError, match=r"times from 0 to 2; t = 2\.1"):
        moved(nodes, step, tmp_path, 2.1)


def test_quaternions_turn_uniformly(tmp_path):
    half = np.radians(45)
    text = f"t qx qy qz qw\n0 0 0 0 1\n1 0 0 {np.sin(half):.17g} {np.cos(half):.17g}\n9 0 0 0 1\n"
    step, nodes = {"rigid": table(tmp_path, text)}, box_nodes()
    exact = Rotation.from_rotvec([0, 0, np.radians(30)]).apply(nodes.points) - nodes.points
    np.testing.assert_allclose(moved(nodes, step, tmp_path, 1 / 3), exact, atol=1e-14)
    np.testing.assert_array_equal(moved(nodes, step, tmp_path, 9.0 + 5e-7), moved(nodes, step, tmp_path, 9.0))
    with pytest.raises(MotionError, match="times from 0 to 9; t = -2e-06 is not among them"):
        moved(nodes, step, tmp_path, -2e-6)


def helix(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stations (n, 3) along z of a beam wound into a helix, its displacement, and its rotation vectors."""
    s = np.linspace(0, 2, n)
    rate = np.array([0.9, 0.3, 5.0])
    return np.stack([0 * s, 0 * s, s], 1), wound(s, rate), s[:, None] * rate


def wound(s: FloatArray, rate: FloatArray) -> FloatArray:
    """Displacement of an axis along z whose sections turn at a constant rate: the integral of exp(s rate) z, closed."""
    size = np.linalg.norm(rate)
    k, z = rate / size, np.array([0.0, 0.0, 1.0])
    angle = (size * s)[:, None]
    way = z * s[:, None] + np.cross(k, z) * (1 - np.cos(angle)) / size
    return way + np.cross(k, np.cross(k, z)) * (s[:, None] - np.sin(angle) / size) - z * s[:, None]


def beam(folder: Path, *columns: FloatArray, header: str = "x,y,z,dx,dy,dz,rx,ry,rz") -> dict:
    np.savetxt(folder / "beam.csv", np.hstack(columns), delimiter=",", header=header, comments="", fmt="%.17g")
    return {"beam": "beam.csv"}


def wiener_milenkovic(turns: FloatArray) -> FloatArray:
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    # Half a turn and more about the opposite axis: what structural solvers write.
    angle, axis = (angle + np.pi) % (2 * np.pi) - np.pi, turns / np.maximum(angle, 1e-300)
    return 4 * np.tan(angle / 4) * axis


def test_beams_follow_the_exact_helix(tmp_path):
    """More than a whole turn between the ends, with whose sections nodes beyond move, and a turn of the root; of third
    order in the distance of stations, for both rotations."""
    nodes = box_nodes()
    nodes.points[:, 2] = 1.2 * nodes.points[:, 2] + 1.0
    s = nodes.points[:, 2].clip(0.0, 2.0)
    _, _, turns = helix(2)
    rate = turns[-1] / 2
    arms = nodes.points - s[:, None] * [0, 0, 1]
    root = Rotation.from_rotvec([0.4, -0.7, 0.2])
    exact = wound(s, rate) + Rotation.from_rotvec(s[:, None] * rate).apply(arms) - arms
    exact = root.apply(nodes.points + exact) - nodes.points
    errors = []
    for n in (21, 41, 81):
        line, shift, turns = helix(n)
        shift, turns = root.apply(line + shift) - line, (root * Rotation.from_rotvec(turns)).as_rotvec()
        found = moved(nodes, beam(tmp_path, line, shift, np.degrees(turns)), tmp_path)
        errors.append(np.abs(found - exact).max())
        same = beam(tmp_path, line, shift, wiener_milenkovic(turns), header="x,y,z,dx,dy,dz,cx,cy,cz")
        np.testing.assert_allclose(moved(nodes, same, tmp_path), found, rtol=0, atol=1e-13)
    assert errors[-1] < 2e-5
    assert np.log2(errors[0] / errors[1]) > 2.8
    assert np.log2(errors[1] / errors[2]) > 2.8


def test_beams_turn_with_their_root_over_time_and_carry_what_lies_beyond(tmp_path):
    """A rigid turn of the whole beam, of which half is a turn by half the angle; static in its own frame."""
    nodes = box_nodes()
    line = np.array([[0.0, 0, -0.5], [0.1, 0, 0.2], [0, 0, 0.5]])
    rows = []
    for time, angle in ((0.0, 0.0), (1.0, 120.0)):
        turn = Rotation.from_rotvec([0, np.radians(angle), 0])
        rows.append(np.hstack([np.full((3, 1), time), line, turn.apply(line) - line, np.tile([0, angle, 0], (3, 1))]))
    step = beam(tmp_path, np.concatenate(rows[::-1]), header="t,x,y,z,dx,dy,dz,rx,ry,rz")
    exact = Rotation.from_rotvec([0, np.radians(120), 0]).apply(nodes.points) - nodes.points
    np.testing.assert_allclose(moved(nodes, step, tmp_path, 1.0), exact, atol=1e-14)
    np.testing.assert_array_equal(moved(nodes, step, tmp_path, 0.0), 0)
    half = Rotation.from_rotvec([0, np.radians(60), 0]).apply(nodes.points - line[0]) - (nodes.points - line[0])
    shift = Rotation.from_rotvec([0, np.radians(120), 0]).apply(line[0]) - line[0]
    for time, fraction in ((0.5, 1.0), (1.0, 0.5)):
        found = moved(nodes, step, tmp_path, time, fraction)
        np.testing.assert_allclose(found, half + 0.5 * shift, atol=1e-14)
    case = case_of({"boundary": [{"select": ["*"], "motion": step}]}, tmp_path)
    with pytest.raises(MotionError, match=r"times from 0 to 1; t = 1\.5"):
        case.case.boundaries[0].motion.require([1.5])
    assert (case.files, case.case.depends_on_time) == ((tmp_path / "beam.csv",), True)
    assert "from -0.5 to 1.5; those beyond an end" in case.case.boundaries[0].motion.prepare(nodes).notes[0]
    for low, high, told in ((0.0, 1.0, 1), (-1.0, 0.0, 1), (-1.5, 8.5, 1), (-2.0, 1.5, 0)):
        ends = np.array([[0.0, 0, low], [0, 0, high]])
        case = case_of({"boundary": [{"motion": beam(tmp_path, ends, 0 * ends, 0 * ends)}]}, tmp_path).case
        notes = case.boundaries[0].motion.prepare(nodes).notes
        assert not case.depends_on_time
        lies = f"from 0 to {high - low:g} along the beam, the nodes lie from {-1 - low:g} to {1 - low:g}; those beyond"
        assert [lies in note for note in notes] == [True] * told


def test_beams_bend_as_parabolas_and_turn_by_whole_turns(tmp_path):
    """Between stations at different distances, for which a parabola and a uniform twist are exact; once around at the
    fourth one."""
    nodes, s = box_nodes(), 1.75 * np.array([-1.0, -0.5, -0.2, 0.2, 0.5, 0.8, 1.0])[:, None]
    along, bent = np.array([0.48, -0.6, 0.64]), np.array([0.1, 0.2, 0.3])
    step = beam(tmp_path, s * along, (s + 1.75) ** 2 * bent, 360.0 / 2.1 * (s + 1.75) * along)
    s = nodes.points @ along[:, None]
    turned = Rotation.from_rotvec(2.0 * np.pi / 2.1 * (s + 1.75) * along).apply(nodes.points)
    exact = turned - nodes.points + (s + 1.75) ** 2 * bent
    np.testing.assert_allclose(moved(nodes, step, tmp_path), exact, atol=1e-12)


def test_modes_add_up(tmp_path):
    nodes = box_nodes()
    shapes = [np.sin(nodes.points + n) for n in (1, 2)]
    for n, shape in enumerate(shapes):
        np.savetxt(tmp_path / f"mode{n}.csv", np.hstack([nodes.points, shape]), delimiter=",")
    (tmp_path / "q.csv").write_text("t,q1,q2\n0,0,1\n1,2,3\n")
    files = {"files": ["mode0.csv", "mode1.csv"]}
    for amplitudes, exact in (({"file": "q.csv"}, (1.0, 2.0)), (["t", "1 - t**2"], (0.5, 0.75))):
        found = moved(nodes, {"modes": {**files, "amplitudes": amplitudes}, "match": "exact"}, tmp_path, 0.5)
        np.testing.assert_allclose(found, exact[0] * shapes[0] + exact[1] * shapes[1], atol=1e-12)
    for header in ("t,mode1,mode0", "t,2,other,1"):
        width = header.count(",")
        rows = ["0" + ",0" * width, "1," + ",".join(["3", "7", "2"] if width == 3 else ["3", "2"])]
        (tmp_path / "q.csv").write_text("\n".join([header, *rows]))
        found = moved(nodes, {"modes": {**files, "amplitudes": {"file": "q.csv"}}, "match": "exact"}, tmp_path, 1.0)
        np.testing.assert_allclose(found, 2 * shapes[0] + 3 * shapes[1], atol=1e-12)
    for header in ("t,q1,q3", "t,a,b", "t,q1,mode_1"):
        (tmp_path / "q.csv").write_text(f"{header}\n0,0,0\n")
        with pytest.raises(FormatError, match=r"belong to shape [12]; expected one called q"):
            moved(nodes, {"modes": {**files, "amplitudes": {"file": "q.csv"}}, "match": "exact"}, tmp_path)


def naca(thickness: float, camber: float, n: int, close: float = 0.1036) -> np.ndarray:
    """NACA four-digit section with the camber at 0.4 chords, from the trailing edge over the upper side."""
    x = 0.5 * (1 + np.cos(np.linspace(0, np.pi, n)))
    y = 5 * thickness * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - close * x**4)
    c = np.where(x < 0.4, camber / 0.16 * (0.8 * x - x**2), camber / 0.36 * (0.2 + 0.8 * x - x**2))
    return np.concatenate([np.stack([x, c + y], 1), np.stack([x, c - y], 1)[-2::-1]])


def wall(outline: np.ndarray, layers: int = 2) -> BoundaryNodes:
    """An O-grid about a section, extruded along z."""
    ring = outline if np.allclose(outline[0], outline[-1]) else np.concatenate([outline, outline[:1]])
    far = 3 * np.stack([np.cos(t := np.linspace(0, 2 * np.pi, len(ring))), np.sin(t)], axis=1)
    far[-1] = far[0]
    plane = np.stack([ring, far], axis=1)
    points = np.zeros((*plane.shape[:2], layers, 3))
    points[..., :2], points[..., 2] = plane[:, :, None], np.arange(layers)
    grid = Grid.from_blocks([points])
    topology = find_topology(grid)
    return BoundaryNodes.of_quads(grid, topology, np.arange(*topology.quads.of_side(0, Side.JMIN).indices(10**9)[:2]))


def write_selig(path: Path, outline: np.ndarray) -> dict:
    path.write_text("NACA\n" + "\n".join(f"{x:.17g} {y:.17g}" for x, y in outline.tolist()))
    return {"airfoil": {"file": path.name}}


def distance_to_curve(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Distances to the spline through an outline, from its tangents at the nearest of many points."""
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    spline = CubicSpline(knots, outline)
    dense = np.linspace(0, knots[-1], 400_001)
    s = dense[cKDTree(spline(dense)).query(points)[1]]
    away, slope = points - spline(s), spline(s, 1)
    return np.abs(away[:, 0] * slope[:, 1] - away[:, 1] * slope[:, 0]) / np.linalg.norm(slope, axis=1)


@pytest.mark.parametrize("forward", [1, -1])
@pytest.mark.parametrize("blunt", [False, True])
def test_walls_become_the_new_airfoil(blunt, forward, tmp_path):
    """Also from behind, where the nodes are numbered from within the base."""
    close = 0.1015 if blunt else 0.1036
    old, new = forward * naca(0.12, 0.0, 41, close), forward * naca(0.15, 0.04, 90, close)
    share = np.array([[0.2], [0.7]]) if blunt else np.zeros((0, 1))
    base, moved_base = (x[-1] + share * (x[0] - x[-1]) for x in (old, new))
    base[:, 0] += 4e-9 * forward
    nodes = wall(np.concatenate([old, base]))
    step = write_selig(tmp_path / "new.dat", new)
    step["airfoil"]["fit"] = "none"
    displacement = moved(nodes, step, tmp_path)
    assert (displacement[:, 2] == 0).all()
    places = (nodes.points + displacement)[:, :2]
    on_base, number = (nodes.points[:, None, :2] == base).all(axis=2).nonzero()
    np.testing.assert_allclose(places[on_base], moved_base[number], atol=1e-8)
    assert distance_to_curve(np.delete(places, on_base, axis=0), new).max() < 1e-9
    assert np.abs(displacement).max() > 0.01
    for edge in (old[0], [0.0, 0.0]):
        at = np.linalg.norm(nodes.points[:, :2] - edge, axis=1) < 1e-12
        assert at.sum() == 2
        assert np.abs(displacement[at][:, 0]).max() < 2e-3
    # Arc lengths: on a wall that is scaled by 2 everything is scaled.
    step = write_selig(tmp_path / "twice.dat", 2 * old)
    assert np.abs(moved(nodes, step, tmp_path)).max() < 1e-8
    step["airfoil"]["fit"] = "none"
    np.testing.assert_allclose(moved(nodes, step, tmp_path)[:, :2], nodes.points[:, :2], atol=1e-8)


@pytest.mark.parametrize("n", [31, 60])
def test_an_airfoil_of_its_own_shape_is_not_turned(n, tmp_path):
    """NACA 4412 as it is defined, thickness across the mean line: the leading edge is at 0, 0, where no point is."""
    x = 0.5 * (1 + np.cos(np.linspace(0, np.pi, 2 * n) + 0.3 / n))[1:-1]
    y = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    mean = np.where(x < 0.4, 0.25 * (0.8 * x - x**2), (0.2 + 0.8 * x - x**2) / 9)
    slope = np.arctan(np.where(x < 0.4, 0.5 * (0.4 - x), 2 * (0.4 - x) / 9))
    across = y[:, None] * np.stack([-np.sin(slope), np.cos(slope)], axis=1)
    line = np.stack([x, mean], axis=1)
    outline = np.concatenate([[[1, 0]], line + across, (line - across)[::-1], [[1, 0]]])
    found = Outline(outline, "naca4412")
    np.testing.assert_allclose(found.leading, [0, 0], atol=2e-4)
    farthest = outline[np.argmax(np.linalg.norm(outline - [1, 0], axis=1))]
    assert abs(farthest[1]) > 5 * abs(found.leading[1])
    nodes, shape = wall(naca(0.12, 0, 61)), write_selig(tmp_path / "a.dat", outline)
    case = case_of({"boundary": [{"motion": shape}]}, tmp_path).case
    assert case.boundaries[0].motion.prepare(nodes).notes == ()
    turned = outline @ Rotation.from_euler("z", 3, degrees=True).as_matrix()[:2, :2].T
    case = case_of({"boundary": [{"motion": write_selig(tmp_path / "b.dat", turned)}]}, tmp_path).case
    (note,) = case.boundaries[0].motion.prepare(nodes).notes
    assert "b.dat is turned by -3" in note


def test_what_cannot_be_matched_is_refused(tmp_path):
    sharp, blunt = naca(0.12, 0, 41), naca(0.12, 0, 41, 0.1015)
    circle = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 41)), np.sin(t)], axis=1)
    lens = circle * np.abs(0.3 * circle[:, 1:]) ** [0.0, 1.0]
    two = Grid.from_blocks([wall(each).grid.block(0) for each in (sharp, sharp + [9.0, 0.0])])
    where = two, find_topology(two)
    several = BoundaryNodes.of_quads(*where, select_quads(*where, ["*.jmin"], ""))
    for nodes, new, message in (
        (wall(sharp), blunt, r"has a blunt trailing edge, that of the wall at \(1, .*\) is sharp"),
        (wall(blunt), sharp, "has a sharp trailing edge, that of the wall"),
        (box_nodes(), sharp, r"one axis; at \[-1.0, -0.33.*\] of its sections 3 edges meet, expected 2"),
        (wall(circle), sharp, "has 0 corners"), (wall(lens), sharp, "has 2 corners"),
        (several, sharp, "the boundary has several outlines; expected one airfoil"),
    ):  # fmt: skip
        with pytest.raises(MotionError, match=message):
            moved(nodes, write_selig(tmp_path / "a.dat", new), tmp_path)


def test_positions_by_number(tmp_path):
    """As SU2 has them: numbers of the exported mesh, in any order, one file or one for each time."""
    nodes = box_nodes()
    order = np.random.default_rng(3).permutation(len(nodes.numbers))
    exact = {}
    for n in (0, 1):
        exact[n] = 0.1 * n * np.sin(nodes.points)
        rows = np.column_stack([nodes.numbers, nodes.points + exact[n]])[order]
        np.savetxt(tmp_path / f"s_{n}.dat", rows, fmt=["%d", "%.17g", "%.17g", "%.17g"])
    step = {"positions": {"file": "s_1.dat"}}
    np.testing.assert_allclose(moved(nodes, step, tmp_path), exact[1], atol=1e-15)
    step = {"positions": {"files": "s_*.dat", "times": [0, 2]}}
    for n in (0, 1):
        np.testing.assert_allclose(moved(nodes, step, tmp_path, 2.0 * n), exact[n], atol=1e-15)
    np.savetxt(tmp_path / "w.dat", np.column_stack([nodes.numbers, nodes.points[order]]), fmt=["%d", *3 * ["%.17g"]])
    with pytest.raises(MotionError, match="of another mesh"):
        moved(nodes, {"positions": {"file": "w.dat"}}, tmp_path)


BEAM, REST = "x,y,z,dx,dy,dz,rx,ry,rz\n", "0,0,0,0,0,0,0,0,0\n"
BAD_TABLES = [
    ("beam", BEAM + REST, "has one station; expected at least two, along a line"),
    ("beam", BEAM + 2 * REST, "first and last stations lie at one point"),
    ("beam", BEAM + REST + 2 * "0,0,1,0,0,0,0,0,0\n", "stations 2 and 3, .* coincide or go back"),
    ("beam", BEAM + REST + "0,0,1,0,0,0,0,175,0\n0,0,2,0,0,0,0,3,0\n", "stations 1 and 2 are turned by 175 degrees "
     "from each other at t = 0; expected up to 170: give stations between"),
    ("positions", "0 0 0 0\n", "no position for"),
    ("positions", "0 0 0 0\n-1 0 0 0\n99999 0 0 0\n", "2 numbers are not of points on block faces, the first -1; th"),
]  # fmt: skip


@pytest.mark.parametrize(("motion", "text", "message"), BAD_TABLES)
def test_tables_are_checked(motion, text, message, tmp_path):
    file = table(tmp_path, text)
    with pytest.raises(MotionError, match=message):
        moved(box_nodes(), {motion: file["file"] if motion == "beam" else file}, tmp_path)
