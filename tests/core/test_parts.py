"""Grids of which every rank holds a part: nothing of the others is read but by asking for it, and results are the same.

The ranks are forks of this process (:mod:`forked_ranks`); rows that a rank does not hold are poisoned.
"""

import dataclasses
import multiprocessing
from contextlib import nullcontext

import numpy as np
import pytest
from cases import body_specs, formulas, turning
from forked_ranks import Failed, on_ranks, poison_parts, small_blocks_are_cut
from grids import block_around, frame, frame_2d, interleaved, permuted, tapered

from meshdeform_core.boundary import BoundarySpec, Kind, crossing
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.grid import Field, Grid
from meshdeform_core.grid.selection import BY_PREFIX
from meshdeform_core.methods import IDW, RBF, TFI, Options
from meshdeform_core.parallel import ONE_PROCESS, Nodes, WholeGridNeeded, scratch, sharing
from meshdeform_core.parallel.scratch import Scratch
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats import grids as grid_formats
from meshdeform_formats.grids import read_grid, write_grid

METHODS = {
    "tfi": Options("tfi"),
    "idw-exact": Options("idw", idw=IDW(summation="exact")),
    "idw-division": Options("idw", idw=IDW(rotation="division", summation="fast")),
    "idw-rbf": Options("idw-rbf"),
    "idw-tfi": Options("idw-tfi"),
    "rbf-exact": Options("rbf", rbf=RBF(summation="exact")),
    "rbf-fast": Options("rbf", rbf=RBF(summation="fast")),
    "rbf-greedy": Options("rbf", rbf=RBF(basis="wendland-c2", radius=6.0, greedy="hybrid", summation="fast")),
    "rbf-tfi-krylov": Options("rbf-tfi", rbf=RBF(solver="krylov")),
    "idw-tfi-fast": Options("idw-tfi", idw=IDW(summation="fast"), tfi=TFI(max_cells=4)),
}
OFF = RepairOptions(mode="off")


@pytest.fixture
def small_pieces(monkeypatch):
    """Blocks are cut although they are small; what a rank does not hold is no number."""
    poison_parts(monkeypatch)
    with small_blocks_are_cut(monkeypatch):
        yield


def part_of(ranks, bounds, values):
    """The part of this rank of an array."""
    part = Nodes.of(Nodes.new(ranks, bounds, values.shape, values.dtype))
    part.own[...] = values[part.low : part.high]
    return part


def test_a_part_refuses_rows_of_others():
    values = np.arange(30.0).reshape(10, 3)

    def look(ranks):
        part = part_of(ranks, [0, 5, 10], values)
        for rows in (slice(3, 8), slice(0, 10, 2)):
            with pytest.raises(IndexError, match="in parts"):
                part[rows]
        with pytest.raises(TypeError):
            part[np.ones(10, bool)]
        for operation in (np.sum, np.asarray, lambda x: x - values, lambda x: np.ptp(x, axis=0)):
            with pytest.raises(WholeGridNeeded):
                operation(part)
        # Alone, a rank would wait for others that do not ask.
        with sharing(apart=True), pytest.raises(RuntimeError, match="by itself"):
            part[np.array([0, 9])]
        return True

    assert all(on_ranks(2, look))


def case_of(method, angle=20.0, specs=None, repair=OFF):
    return Case(tuple(specs or body_specs(turning(angle))), method=METHODS[method], repair=repair)


def between_ends(method, motion=None, repair=OFF):
    """The body of a grid whose blocks have other indices along z, between slip ends; a plane grid has none."""
    body = dataclasses.replace(body_specs(motion or turning(20.0))[0], select=("*",))
    ends = BoundarySpec("ends", ("*",), Kind.SLIP, expression("z < 0.01 or z > 0.99", {"x", "y", "z"}))
    return case_of(method, specs=(body, ends), repair=repair)


def turned(grid, axes, *flips):
    return permuted(grid, axes, flips or (False, False, False))


def outcome(source, target, case, ranks=ONE_PROCESS, **rest):
    """The bytes of the deformed grid, and all that is reported."""
    result = deform(read_grid(source, ranks=ranks), case, **rest)
    variant = {"precision": rest["precision"]} if "precision" in rest else None
    write_grid(result.grid, target, variant)
    account, repair = (
        dataclasses.asdict(result.account),
        result.repair and dataclasses.replace(result.repair, seconds=0.0),
    )
    return target.read_bytes(), result.assessment, account, result.warnings, result.attempts, repair


def same_on_ranks(tmp_path, count, case, suffix=".cgns", grid=None, **rest):
    """Compare deforming a file on several ranks, each with a part, with deforming it in one process."""
    source = tmp_path / f"grid{suffix}"
    write_grid(grid or frame(6, 5), source)
    expected = outcome(source, tmp_path / f"one{suffix}", case, **rest)

    for found in on_ranks(count, lambda ranks: outcome(source, tmp_path / f"ranks{suffix}", case, ranks, **rest)):
        for one, two in zip(found, expected, strict=True):
            assert one == two
    return expected


def plane(method):
    return dataclasses.replace(case_of(method), boundaries=between_ends(method).boundaries[:1])


SWAYING = formulas("0.1*z", "0.0", "0.2*sin(pi*z)")
LOWER = block_around(*[np.linspace(0.0, 1.0, 5)] * 3)
# A block stands with an edge on a slip side of another, whose rank learns that its nodes there are those of an edge.
UPPER = LOWER @ [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 1.0]] + [0.5, 0.0, 1.0]
STANDING = (
    BoundarySpec("slip", ("block1.kmax", "block2.imin", "block2.kmin"), Kind.SLIP),
    BoundarySpec("wall", ("block1.kmin", "block2.kmax"), Kind.MOVING, None, formulas("0", "0.05*sin(3*z)", "0")),
)
# Number of ranks, case, and what is not as in the others.
SAME = {
    "idw-exact": (3, case_of("idw-exact"), {"suffix": ".xyz", "steps": 2, "precision": "float32"}),
    "idw-division": (4, case_of("idw-division"), {}),
    "invalid cells": (3, case_of("tfi", 150.0), {"suffix": ".xyz", "steps": 1}),
    "rbf-exact": (3, case_of("rbf-exact"), {"suffix": ".xyz"}),
    "periodic sides that move": (3, case_of("rbf-tfi-krylov", specs=body_specs(turning(20), Kind.PERIODIC)), {}),
    "plane": (3, plane("idw-tfi-fast"), {"suffix": ".xyz", "grid": frame_2d(9)}),
    "plane along j": (3, plane("rbf-greedy"), {"suffix": ".xyz", "grid": turned(frame_2d(9), (2, 0, 1))}),
    # Nodes of one plane follow those of the other, whoever holds them.
    "one layer": (3, between_ends("rbf-fast"), {"grid": turned(frame(9, 1), (2, 0, 1), False, False, True)}),
    "edge on a slip side": (2, case_of("idw-rbf", specs=STANDING), {"grid": Grid.from_blocks([LOWER, UPPER])}),
    # Nodes on slip sides, which are the first and the last plane, are no centres; the motion leaves the sides.
    "interiors between slip sides": (3, between_ends("idw-rbf", SWAYING), {"grid": turned(frame(5, 8), (2, 0, 1))}),
}


@pytest.mark.parametrize("name", SAME)
def test_ranks_give_the_same_bytes(name, tmp_path, small_pieces):
    count, case, rest = SAME[name]
    same_on_ranks(tmp_path, count, case, **rest)


REPAIRS = {
    # The first rank repairs for all, whatever the grid.
    "tapered": (case_of("tfi", 50.0, repair=RepairOptions()), tapered(5, 4)),
    "extruded": (between_ends("tfi", turning(50.0), RepairOptions()), turned(frame(5, 8), (2, 0, 1))),
}


@pytest.mark.parametrize("name", REPAIRS)
def test_repairs_of_grids_in_parts_give_the_same_bytes(name, tmp_path, small_pieces):
    case, grid = REPAIRS[name]
    assert same_on_ranks(tmp_path, 3, case, grid=grid)[-1].newton_steps > 1


@pytest.fixture
def in_files(tmp_path, monkeypatch):
    """Every rank stores all but the smallest arrays in files; all pages are returned at every look."""
    monkeypatch.setattr(scratch, "SMALLEST", 500)
    folder = tmp_path / "files"
    folder.mkdir()
    made = Scratch.blank
    used = multiprocessing.get_context("fork").Value("i", 0)

    def counted(self, shape, dtype):
        used.value += 1
        return made(self, shape, dtype)

    monkeypatch.setattr(Scratch, "blank", counted)
    yield lambda: sharing(scratch=Scratch(folder, 1))
    assert used.value > 20
    assert not list(folder.iterdir())


def overset(**grids):
    """Grids that overlap, as blocks called NAME.NUMBER of one grid, those of different ones in turn; and their
    boundaries, of which the first and the third have moving walls."""
    specs = [
        dataclasses.replace(spec, name=f"{name} {spec.name}", select=tuple(f"{name}.*.{p[2:]}" for p in spec.select))
        for name in list(grids)[::2] for spec in body_specs(turning(20.0))
    ]  # fmt: skip
    still = [BoundarySpec("still", (f"{list(grids)[1]}.*.*",), Kind.FIXED)]
    return interleaved(**grids), tuple(specs + still)


def test_components_of_overset_grids_give_the_same_bytes(tmp_path, small_pieces):
    grid, specs = overset(bar=tapered(5, 4), bg=frame(4, 3), rod=frame(5, 4))
    case = Case(specs, method=METHODS["idw-tfi"], components=BY_PREFIX, open_faces=True)
    same_on_ranks(tmp_path, 3, case, grid=grid)


def levels(source, target, case, schedule, ranks=ONE_PROCESS):
    """The bytes of all levels, and what is reported of each."""
    found = []
    for level in deform_series(set_up(read_grid(source, ranks=ranks), case), schedule, "float64"):
        write_grid(level.result.grid, target)
        account = dataclasses.asdict(level.result.account)
        measured = level.result.assessment, level.result.motion, level.smoothness
        found.append((target.read_bytes(), account, level.result.warnings, measured))
    return found


@pytest.mark.parametrize(("place", "method"), [("small_pieces", "idw-tfi"), ("in_files", "rbf-tfi-krylov")])
def test_levels_of_a_series_are_the_same(place, method, tmp_path, small_pieces, request):
    store, source, schedule = request.getfixturevalue(place), tmp_path / "grid.xyz", Schedule((0.0, 1.0, 4.0))
    write_grid(frame(6, 5), source)
    case = case_of(method, "5*t")
    expected = levels(source, tmp_path / "one.xyz", case, schedule)

    def act(ranks):
        with (store or nullcontext)():
            return levels(source, tmp_path / "ranks.xyz", case, schedule, ranks)

    assert all(found == expected for found in on_ranks(3, act))


def test_ranks_without_nodes_take_part(tmp_path, monkeypatch):
    """The blocks are not cut: more ranks than pieces."""
    poison_parts(monkeypatch)
    grid = frame(9, 8)
    blocks = Grid.from_blocks([grid.block(0), grid.block(1)])
    same_on_ranks(tmp_path, 3, case_of("idw-tfi-fast"), suffix=".xyz", grid=blocks)


def test_what_takes_the_whole_grid_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(grid_formats, "_SAMPLE", 2)
    source = tmp_path / "grid.xyz"
    write_grid(frame(), source)
    with pytest.raises(Failed, match="a sample of its nodes lies on one line"):
        on_ranks(2, lambda ranks: read_grid(source, ranks=ranks))
    monkeypatch.undo()
    with pytest.raises(Failed, match="a block is read as a whole"):
        on_ranks(2, lambda ranks: read_grid(source, ranks=ranks).block(0))


def test_a_whole_grid_is_divided_with_its_fields(small_pieces):
    grid, random = frame(6, 5), np.random.default_rng(2)
    sizes = ((b, shape) for b in (0, 3) for shape in (grid.shapes[b], (*grid.cell_shapes[b], 3)))
    fields = tuple(Field("f", "cell" if len(size) == 4 else "node", b, random.random(size)) for b, size in sizes)
    grid = dataclasses.replace(grid, fields=fields)

    def act(ranks):
        part = grid.divided(ranks)
        return part.points.own, [each.own for each in part.fields], part.few(3, np.s_[1:3, :2, 4:])

    points, values, few = zip(*on_ranks(3, act), strict=True)
    np.testing.assert_array_equal(np.concatenate(points), grid.points)
    for own, field in zip(zip(*values, strict=True), fields, strict=True):
        np.testing.assert_array_equal(np.concatenate(own), field.values)
    for found in few:
        np.testing.assert_array_equal(found, grid.block(3)[1:3, :2, 4:])


def test_ranks_share_the_test_whether_walls_cross(tmp_path, small_pieces, monkeypatch):
    """Every rank tests an equal share of the faces of a wall that folds onto itself, and learns what all have found."""
    line = np.linspace(0.0, 1.0, 21)
    write_grid(Grid.from_blocks([block_around(2.0 * line, line, line)]), tmp_path / "grid.cgns")
    fold = formulas("where(x > 1, -1.6*(x - 1), 0)", "0", "where(x > 1, 0.8*sin(pi*(x - 1)), 0) - 0.7*(x > 1.7)")
    floor = BoundarySpec("floor", ("*.kmin",), Kind.MOVING, motion=fold)
    case = Case((floor, BoundarySpec("sides", ("*.i*", "*.j*"), Kind.SLIP)))
    search, asked = crossing.crossing_faces, []
    monkeypatch.setattr(
        crossing, "crossing_faces", lambda *given: (asked.append(int(given[3].sum())), search(*given))[1]
    )

    def found(ranks):
        setup = set_up(read_grid(tmp_path / "grid.cgns", ranks=ranks), case)
        del asked[:]
        return setup.undeformed.crossings(setup.displacement(0.0)), sum(asked)

    expected, faces = found(ONE_PROCESS)
    assert expected[0].patches == ("floor", "floor")
    shares = on_ranks(3, found)
    assert [each for each, _ in shares] == [expected] * 3
    assert [share for _, share in shares] == [pytest.approx(faces / 3, abs=1)] * 3
