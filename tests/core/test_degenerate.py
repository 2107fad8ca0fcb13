"""Degenerate grids and motions: a message or a right result, never a traceback."""

import contextlib

import numpy as np
import pytest
from cases import STILL, body_specs, constant, formulas, problem_of, turning
from grids import block_around, frame

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Follow, Motion
from meshdeform_core.boundary.tables import Matching, SurfaceData
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import GridError, MeshDeformError
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, RBF, Options
from meshdeform_core.repair import RepairOptions

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


@pytest.mark.parametrize("method", [*map(Options, ("tfi", "rbf", "idw-rbf")), Options("idw", idw=IDW(alpha="auto"))])
@pytest.mark.parametrize(
    ("cells", "slip"), [((1, 1, 1), True), ((1, 4, 4), False), ((4, 4, 1), True), ((4, 1, 0), True), ((1, 1, 0), False)]
)
def test_tiny_grids_end_with_a_message_or_a_grid(method, cells, slip):
    lines = [np.linspace(0.0, 1.0, n + 1) if n else np.zeros(1) for n in cells]
    grid = Grid.from_blocks([block_around(lines[0] + shift, lines[1], lines[2]) for shift in (0.0, 1.0)])
    ends = BoundarySpec("ends", ("*.kmin", "*.kmax") if cells[2] else ("*.imin", "*.imax"), Kind.SLIP)
    wall = BoundarySpec("wall", ("*.jmin",), Kind.MOVING, None, formulas("0", "0.01*x", "0"))
    with contextlib.suppress(MeshDeformError):
        result = deform(grid, Case((wall, ends) if slip else (wall,), method=method))
        assert np.isfinite(result.grid.points).all()
        assert np.isfinite([result.assessment.after.f_skew.min, result.max_displacement]).all()


FRAME, BAR = frame(), tuple(body_specs(constant(0.1, 0.0, 0.0)))
NODES = np.unique(FRAME.points[np.abs(FRAME.points[:, :2]).max(axis=1) < 0.51], axis=0)
MOVED = [SurfaceData(x, 0 * x, np.empty((0, 3), int), n) for n, x in (("a.csv", NODES[:-4]), ("b.csv", NODES[4:]))]
TWO = Motion((Follow(lambda number: MOVED[number], Matching("nearest", partial=True), (0.0, 2.0, 9e6)),), {})


def moved_where(text):
    return problem_of(FRAME, [BoundarySpec("left", ("block1.i*",), Kind.MOVING, expression(text, {"x", "z"}), STILL)])


def with_bar(motion, steps=None, time=0.0):
    case = Case(tuple(body_specs(motion)), repair=RepairOptions("off"))
    first, *rest = deform(FRAME, case, steps=steps, time=time).warnings
    assert first.startswith("180 external face quads are not selected by any boundary entry; they are fixed")
    assert first.endswith("block8.jmax (18), block2.imin (15), block4.jmin (15) and 6 more ranges")
    return rest


def pair(left, right):
    """Bars at both ends of a period, which move in z."""
    near = expression("y < 0.6", {"y"})
    ends = [("imin", left), ("imax", right)]
    bars = [BoundarySpec(f, (f"*.{f}",), Kind.MOVING, near, formulas("0", "0", z)) for f, z in ends]
    period = BoundarySpec("period", ("*.imin", "*.imax"), Kind.PERIODIC)
    return Case((*bars, period, BoundarySpec("rest", ("*.j*", "*.k*"), Kind.FREE)))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: BoundarySpec("a", ("*",), Kind.MOVING), "boundary 'a' has no motion; expected a motion for"),
        (lambda: BoundarySpec("a", ("*",), Kind.SLIP, None, STILL), "boundary 'a' is slip but has a motion; expected"),
        (lambda: Case((), method="tfi"), "method = 'tfi' of a case; expected Options, like Options('idw-tfi')"),
        (lambda: Case((*BAR, "a")), "of a case; expected BoundarySpec entries"),
        (lambda: RepairOptions(time_limit=0.0), "time_limit = 0.0; expected seconds > 0"),
        (lambda: Options("idw-tfi", rbf=RBF(radius=2.0)), "; it takes IDW and TFI. Leave them out"),
        (lambda: Options("idvtfi"), "idw-idw, rbf-tfi, idw-rbf, idw-tfi; did you mean 'idw-tfi'?"),
        (lambda: set_up(FRAME, Case(BAR[1:])), "no node moves: no boundary entry of kind moving selects any node"),
        (lambda: with_bar(STILL, 0), 'steps = 0; expected a whole number >= 1 or "auto"'),
        (lambda: moved_where("sqrt(0.9 - z) > 1"), " at 5 of 20 nodes, first at block1 (1, 1, 4) = (-2, -2, 1); "),
        (lambda: moved_where("z < 0.1"), " is not satisfied on any face of the selection (5 of 20 nodes satisfy it; "
         "the selection spans x -2 to -2, y -2 to -0.5, z 0 to 1)"),
        (lambda: problem_of(FRAME, [BoundarySpec("pitch", ("block1.imin",), Kind.PERIODIC), *BAR]),
         "boundary 'pitch' is periodic but has 1 select patterns, and the file declares no periodic connection"),
        (lambda: [deform(Grid.from_blocks([CUBE]), pair("0.01", z)) for z in ("0.01", "0.01 + 0.02*y")],
         "two periodic images of a node move differently: (0, 0, 0.01) where the other would give it (0, 0, 0.02); gi"),
        (lambda: deform(FRAME, Case(tuple(BoundarySpec(face, (face,), Kind.MOVING, None, formulas(x, "0", "0"))
                                          for face, x in (("block2.imax", "0.1"), ("block4.jmax", "0.1 + z"))))),
         "moving patches 'block2.imax' and 'block4.jmax' disagree at their shared node block1 (5, 5, 4): displacements "
         "(0.1, 0, 0) and (1.1, 0, 0); give both patches the same motion there, or select these nodes in one of them"),
        (lambda: with_bar(formulas("0.1", "log(0.4-x)", "0")), "motion step 1 gives the displacement (0.1, nan, 0) at "
         "node block4 (6, 5, 1) = (0.5, -0.5, 0), t = 0 (24 of 80 nodes); expected finite numbers up to 1e+30: check"),
        (lambda: with_bar(TWO, time=1.5), "no level at t = 1.5; it has 3 levels from 0 to 9e+06, the nearest at 2. Ch"),
        (lambda: with_bar(TWO, time=2.0), "b.csv matches 76 boundary nodes, a.csv others (76); expected all tables of"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(act, message):
    with pytest.raises(MeshDeformError) as caught:
        act()
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (("0", "0", "0"), "nothing moves: the displacement is zero everywhere; check"),
        (("114*x", "0", "0"), ""),
        (("115*x", "0", "0"), "the largest displacement, 57.5, is 10 times the size of the grid, 5.745: is it in the"),
        (("x", "1.001*y", "z"), "the displacements are nearly the coordinates of the nodes themselves, so the wall"),
        (
            ("0.1*z", "0", "-0.07*z"),
            "the motion carries nodes out of a slip or symmetry plane by up to 0.07; the plane",
        ),
    ],
)
def test_what_is_doubtful_is_told(motion, message):
    told = with_bar(formulas(*motion))
    assert told[0].startswith(message) if message else told == []
