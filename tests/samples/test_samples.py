"""Every sample as a user starts from it: the commands of its README, at its smallest named size."""

import dataclasses
import json
import shlex

import numpy as np
import pytest

from meshdeform_cli.main import run
from meshdeform_core.deform import Timing, impose, set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid.topology import find_topology, quads_of_patches
from meshdeform_core.methods import Options
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case
from meshdeform_samples import SAMPLES, folder, generate, load

WALL, FAR, PLANE = "BCWall", "BCFarfield", "BCSymmetryPlane"
# A size and its cells, from the paper or from areas over those of cells; a wrong size; patches with their types.
SIZES = {
    "square": (21, 20 * 20, 2, dict.fromkeys(("bottom", "top", "left", "right"), WALL)),
    "airfoil": (401, 400 * 240, 8, {"airfoil": WALL, "outer": FAR}),
    "splitter-plate": (8, (12 * 13 - 1 - 5 * 0.25) * 8**2 * 4, 12, {"span": PLANE, "body": WALL, "outer": FAR}),
    "hemisphere": (12, 17 * (12 * 12 + 4 * 12 * 9), 10, {"plate": WALL, "membrane": WALL, "outer": FAR}),
    "beam": (40, 40 * 21 - 10, 60, {"outer": FAR, "beam": WALL}),
    "wing": (12, 2 * 24 * 18 * 12, 10, {"symmetry": PLANE, "wing": WALL, "far": FAR}),
    "cascade": (16, 47 * 16**2, 5, {"bar": WALL, "inlet": "BCInflow", "outlet": "BCOutflow", "lower": "", "upper": ""}),
    "valve": (16, 36 * 17 * 4 - 64, 12, {"sides": PLANE, "flap": WALL, "floor": WALL, "channel": FAR}),
    "workshop-cylinder": (8, 5 * 8 * 8, 3, {"wall": WALL}),
}  # fmt: skip


@pytest.mark.parametrize("name", SAMPLES)
def test_sizes_and_patches(name):
    size, cells, wrong, types = SIZES[name]
    module = load(name)
    grid, most = module.generate(size), 10 * max(module.SIZES.values())
    assert (grid.n_cells, {patch.name: patch.bc_type for patch in grid.patches}) == (cells, types)
    topology = find_topology(grid)
    quads = np.sort(quads_of_patches(topology.quads, grid.patches)[0])
    np.testing.assert_array_equal(quads, np.flatnonzero(topology.external))
    assert bool(grid.connections) == (name != "square")
    for given, message in (
        (wrong, f"size = {wrong} .*; expected"),
        (most + 1, f"size = {most + 1}; expected at most {most}"),
        ("\u0661", "--size '\u0661'; expected a whole number or one of small"),
    ):
        with pytest.raises(CaseError, match=f"sample {name}: {message}"):
            generate(name, given)


def documented(name, command):
    """The first such command of a sample's README, without the program's name."""
    lines = (folder(name) / "README.md").read_text(encoding="utf-8").splitlines()
    found = [line.split() for line in lines if line.strip().startswith(f"meshdeform {command}")]
    return shlex.split(" ".join(found[0][1:]))


def write_sample(name):
    assert run([*documented(name, "sample"), "--size", "small"]) == 0


@pytest.mark.parametrize("name", SAMPLES)
def test_readme_commands_give_a_valid_grid(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sample(name)
    arguments = documented(name, "deform")
    extra = [] if "--report" in arguments else ["--report", "case/report.json"]
    assert run([*arguments, *extra, "--quiet"]) == 0
    report = json.loads((tmp_path / "case/report.json").read_text())
    assert report["valid"] is True
    assert report["boundary"]["moving_nodes"] > 0
    assert report["quality"]["after"]["f_skew"]["min"] > 0.1
    before, after = read_grid("case/grid.cgns"), read_grid(arguments[arguments.index("-o") + 1])
    largest = np.linalg.norm(after.points - before.points, axis=1).max()
    assert largest >= 0.99 * report["boundary"]["max_displacement"] > 0


def test_the_wing_moves_as_the_structural_model_does(tmp_path, monkeypatch):
    """Pitch about the quarter chord, then bending with the square of the span, on nodes the table does not have."""
    monkeypatch.chdir(tmp_path)
    write_sample("wing")
    grid, case = read_grid("case/grid.cgns"), read_case("case/case.toml").case
    setup = set_up(grid, case)
    moved = setup.displacement(0.0)
    (wing,) = (patch.nodes for patch in setup.boundary.patches if patch.name == "wing")
    x, y, z = grid.points[setup.topology.first[wing]].T
    turn = np.deg2rad(6.0)
    c, s = np.cos(turn), np.sin(turn)
    expected = np.stack([c * (x - 0.25) + s * z + 0.25 - x, 0 * y, c * z - s * (x - 0.25) - z + 0.075 * y**2], axis=1)
    # The model's panels cut across the curved skin and the parabola of the bending.
    assert np.abs(moved[wing] - expected).max() < 2e-3


@pytest.mark.parametrize("method", ["idw-rbf", "idw-tfi"])
def test_no_jump_beside_periodic_boundaries(method, tmp_path, monkeypatch):
    """The cascade fits onto itself after one pitch, and the interior follows: the first cells keep their heights."""
    monkeypatch.chdir(tmp_path)
    write_sample("cascade")
    assert run([*documented("cascade", "deform"), "-m", method, "--quiet"]) == 0
    before, after = read_grid("case/grid.cgns"), read_grid("case/deformed.cgns")
    moved, (x, y, _) = after.points - before.points, before.points.T
    for place in np.unique(x):
        lower, upper = (moved[(x == place) & (y == side)] for side in (-2.0, 2.0))
        np.testing.assert_allclose(lower[0], upper[0], rtol=0, atol=1e-14)
    assert np.abs(moved[y == 2.0]).max() > 0.05
    heights = []
    for grid in (before, after):
        for name, j in (("lower-bar", 0), ("upper-bar", -2)):
            block = grid.block(grid.names.index(name))[:, :, 0]
            heights.append(np.linalg.norm(block[:, j + 1] - block[:, j], axis=1))
    ratio = np.concatenate(heights[2:]) / np.concatenate(heights[:2])
    assert ratio.min() > 0.5
    assert ratio.max() < 1.6


def test_the_valve_opens_with_time_and_closes_again():
    module = load("valve")
    grid = module.generate(module.SIZES["small"])
    case = read_case(str(folder("valve") / "case.toml")).case
    setup = set_up(grid, case)
    (flap,) = (patch.nodes for patch in setup.boundary.patches if patch.name == "flap")
    arm = grid.points[setup.topology.first[flap]]
    for time, angle in ((0.0, 0.0), (0.05, 17.5), (0.1, 35.0), (9.0, 35.0)):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        turned = arm @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
        np.testing.assert_allclose(setup.displacement(time)[flap], turned - arm, rtol=0, atol=1e-14)


@pytest.mark.parametrize("method", ["idw-tfi", "idw", "rbf"])
@pytest.mark.parametrize("name", ["case.toml", "case2.toml"])
def test_the_interior_of_the_workshops_cylinder_follows_the_affine_map_of_its_wall(name, method):
    """Formulas of the suite: an area-preserving stretch, a turn and a shift."""
    grid, t = load("workshop-cylinder").generate(8), 1.3
    case = read_case(str(folder("workshop-cylinder") / name)).case
    setup = set_up(grid, dataclasses.replace(case, method=Options(method)))
    moved = impose(setup, setup.motion(t), None, "float64", Timing()).grid.points
    alpha = t**3 * (8 - 3 * t) / 16 if name == "case.toml" else 0.3 * np.sin(6 * t) * t**6 / (t**6 + 1)
    psi, c, s = 1 + 0.5 * alpha, np.cos(np.pi * alpha), np.sin(np.pi * alpha)
    exact = grid.points @ np.array([[c * psi, s * psi, 0], [-s / psi, c / psi, 0], [0, 0, 1]]) + [0, alpha, 0]
    assert np.abs(moved - exact).max() < 1e-12 < 0.1 < np.abs(moved - grid.points).max()
