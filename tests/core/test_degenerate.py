"""Degenerate grids and motions: a message or a right result, never a traceback."""

import json

import numpy as np
import pytest
from cases import formulas, turning
from grids import block_around

from meshdeform_cli.main import run
from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions import expression
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import GridError, MotionError
from meshdeform_core.grid import Grid
from meshdeform_formats import write_grid

LINE = np.linspace(0.0, 1.0, 3)
CUBE = block_around(LINE, LINE, LINE)
NOTHING = {
    "point": (CUBE * 0.0 + 1.5, r"^all nodes lie within 0 of \(1.5, 1.5, 1.5\); expected"),
    "line": (CUBE[..., :1] + np.zeros(3), "^all nodes of the 3-D grid lie on a line; expected"),
    "plane": (CUBE * [1.0, 1.0, 0.0], "^all nodes of the 3-D grid lie in a plane; expected"),
    "tiny": (CUBE * 1e-150, "all nodes lie within 1e-150"),
    "2-D line": (CUBE[:, :, :1] * [1.0, 0.0, 0.0], "^all nodes of the 2-D grid lie on a line; expected"),
}


@pytest.mark.parametrize("name", NOTHING)
def test_grids_without_extent_are_refused(name):
    block, words = NOTHING[name]
    wall = BoundarySpec("wall", ("*.jmin",), Kind.MOVING, None, turning(1.0))
    with pytest.raises(GridError, match=words):
        set_up(Grid.from_blocks([block]), Case((wall,)))


@pytest.mark.parametrize("method", ["tfi", "rbf", "idw-rbf", "idw-auto"])
@pytest.mark.parametrize(
    ("cells", "slip"), [((1, 1, 1), True), ((1, 4, 4), False), ((4, 4, 1), True), ((4, 1, 0), True), ((1, 1, 0), False)]
)
def test_tiny_grids_end_with_a_message_or_a_grid(method, cells, slip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = [np.linspace(0.0, 1.0, n + 1) if n else np.zeros(1) for n in cells]
    blocks = [block_around(lines[0] + shift, lines[1], lines[2]) for shift in (0.0, 1.0)]
    write_grid(Grid.from_blocks(blocks), tmp_path / "g.xyz", {"precision": "float64"})
    faces = "'*.kmin','*.kmax'" if cells[2] else "'*.imin','*.imax'"
    more = f",{{name='s',select=[{faces}],kind='slip'}}" if slip else ""
    entry = f"boundary=[{{name='w',select=['*.jmin'],motion=[{{displace=['0','0.01*x','0']}}]}}{more}]"
    auto = ["-s", 'method.idw.alpha="auto"'] if method == "idw-auto" else []
    name = method.removesuffix("-auto")
    code = run(["deform", "g.xyz", "-s", entry, "-m", name, *auto, "-o", "o.xyz", "--report", "r.json", "-q"])
    assert code in (0, 2, 3)
    if code != 2:
        json.loads((tmp_path / "r.json").read_text(), parse_constant=lambda text: pytest.fail(f"{text} in the report"))


def test_images_of_a_periodic_pair_must_move_alike():
    """The moving bars at both ends of a period get different motions."""
    line, z = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 3)
    grid = Grid.from_blocks([block_around(line, line, z)])
    near = expression.expression("y < 0.6", {"x", "y", "z"})

    def case(left: str, right: str) -> Case:
        return Case(
            (
                BoundarySpec("left", ("block1.imin",), Kind.MOVING, near, formulas("0", "0", left)),
                BoundarySpec("right", ("block1.imax",), Kind.MOVING, near, formulas("0", "0", right)),
                BoundarySpec("pair", ("block1.imin", "block1.imax"), Kind.PERIODIC),
                BoundarySpec("rest", ("*.j*", "*.k*"), Kind.FREE),
            )
        )

    deform(grid, case("0.01", "0.01"))
    with pytest.raises(MotionError, match="move differently"):
        deform(grid, case("0.01", "0.02"))
