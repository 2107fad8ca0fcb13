"""Templates of case files, compared with `expected/` line by line; what a fitted table is taken to be."""

from __future__ import annotations

import dataclasses
import json
import tomllib

import expected
import numpy as np
import pytest
from grids import frame, frame_2d, with_walls

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.faces import find_outside
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats import write_grid
from meshdeform_formats.case import case_of
from meshdeform_formats.case.template import FittedTable, case_template, fitted_table
from meshdeform_samples import generate


def template(grid: Grid, *more) -> str:
    return case_template(grid, find_outside(grid, find_topology(grid)), "a.xyz", *more)


def renamed(grid: Grid, **names: str) -> Grid:
    patches = tuple(dataclasses.replace(p, name=names[p.family], family="") for p in grid.patches)
    return dataclasses.replace(grid, patches=patches)


def cube() -> Grid:
    axes = [np.array([0.1, 1 / 3, 2 / 3]), np.array([0.0, 0.5, 1.1]), np.array([0.0, 1.0, 2.0])]
    return Grid.from_blocks([np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)], ["b[1]"])


def plane() -> Grid:
    flat = frame_2d()
    return flat.moved(flat.points / 3.0 + [-0.1, 0.7, 0.0])


def thin(axis: int) -> Grid:
    """One cell thick along x, y or z."""
    flat = frame_2d()
    points = np.roll(flat.points, axis - 2, axis=1)
    blocks = [flat.block(b, points) for b in range(flat.n_blocks)]
    return Grid.from_blocks([np.concatenate([x, x + np.eye(3)[axis]], axis=2) for x in blocks])


def shifted(grid: Grid, *by: float) -> Grid:
    return grid.moved(grid.points + by)


def cyclic(grid: Grid) -> Grid:
    patches = tuple(dataclasses.replace(p, bc_type="cyclic") if p.family == "span" else p for p in grid.patches)
    return dataclasses.replace(grid, patches=patches)


ODD = {"body": 'the "wing" [1] \\ é', "outer": "a # b", "span": "*?"}
TEMPLATES = {
    "patches": lambda: template(with_walls(frame())),
    "no_names": lambda: template(frame(), "maps/a.nmf"),
    "odd_names": lambda: template(renamed(with_walls(frame()), **ODD)),
    "no_wall": lambda: template(cube()),
    "plane": lambda: template(plane()),
    "wing": lambda: template(generate("wing", 8)[0]),
    "wing_beyond": lambda: template(shifted(generate("wing", 8)[0], 0, 3, 0)),
    "cyclic": lambda: template(cyclic(with_walls(frame()))),
    "some_walls": lambda: template(frame(3, 1), None, FittedTable("t.csv", ("block2.imax",), "nearest", 1e-9)),
    "table": lambda: template(with_walls(frame()), None, FittedTable("t.csv", ("body", "span"), "exact", 0.25)),
}


@pytest.mark.parametrize("name", TEMPLATES)
def test_templates(name):
    text = TEMPLATES[name]()
    assert text == expected.text(f"{name}.toml")
    # What it proposes is a case; brackets in names match any character.
    assert [entry["name"] for entry in tomllib.loads(text)["boundary"]]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_motion_to_fill_in_turns_a_plane_grid_in_its_plane(axis):
    text = template(thin(axis))
    assert f"axis = {[int(n == axis) for n in range(3)]}, center" in text
    (line,) = [line for line in text.splitlines() if "displace = " in line]
    parts = json.loads(line.split("displace = ")[1].removesuffix(" }"))
    assert parts[axis] == "0"
    assert "xyz"[axis] not in "".join(parts).replace("sin", "")


def test_odd_names_select_what_they_name():
    grid = renamed(with_walls(frame()), **ODD)
    setup = set_up(grid, case_of(tomllib.loads(template(grid))).case)
    assert [spec.name for spec in setup.case.boundaries] == [ODD["body"], ODD["span"], ODD["outer"]]
    assert setup.boundary.count(Kind.MOVING) == 4 * 4 * (4 + 1)


def test_bending_begins_and_ends_with_all_digits():
    grid = plane()
    (line,) = [line for line in template(grid).splitlines() if "displace = " in line]
    formula = expression(json.loads(line.split("displace = ")[1].removesuffix(" }"))[1], ("x",))
    x = grid.points[np.abs(grid.points[:, :2] - [-0.1, 0.7]).max(axis=1) < 0.51 / 3, 0]
    assert [abs(formula({"x": end})) < 1e-15 for end in (x.min(), x.max())] == [True, True]
    assert formula({"x": x.mean()}) == pytest.approx(np.ptp(x) / 20, rel=0.03)


@pytest.mark.parametrize(("off", "match", "reach"), [(0.0, "nearest", 1.8e-9), (0.0123, "interpolate", 0.013)])
def test_a_table_is_fitted_to_the_wall_that_it_covers(off, match, reach, tmp_path):
    grid = with_walls(frame())
    points = grid.points[np.abs(grid.points[:, :2]).max(axis=1) < 0.51] + [0, 0, off]
    table = np.unique(np.hstack([points, np.tile([0.1, 0, 0], (len(points), 1))]), axis=0)
    np.savetxt(tmp_path / "t.csv", table, "%.17g", delimiter=",", header="x,y,z,dx,dy,dz", comments="")
    found = fitted_table(grid, find_topology(grid), tmp_path / "t.csv", "../t.csv")
    assert found == FittedTable("../t.csv", ("body",), match, reach)
    write_grid(grid, tmp_path / "moved.xyz")
    with pytest.raises(
        CaseError, match=r"moved\.xyz is a grid with deformed positions, .*motion = \[\{ file = \"m\" \}\]"
    ):
        fitted_table(grid, find_topology(grid), tmp_path / "moved.xyz", "m")
