"""Files of which every rank reads and writes its part: the same bytes as in one process, whatever they hold.

The ranks are forks of this process (:mod:`forked_ranks`); rows that a rank does not hold are poisoned.
"""

import os
from dataclasses import replace

import h5py
import numpy as np
import pytest
from cases import body_specs, turning
from cgns_witness import N, box, tree, write_hdf5, zone
from forked_ranks import on_ranks, poison_parts, small_blocks_are_cut
from grids import frame, frame_2d, tapered
from plot3d_witness import binary_file, sample_blocks, sample_iblank

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import Follow, Motion
from meshdeform_core.boundary.tables import Matching
from meshdeform_core.deform import Case, Timing, deform, impose, set_up
from meshdeform_core.grid import Field, Grid
from meshdeform_core.methods import Options
from meshdeform_core.parallel import ONE_PROCESS, Nodes, WholeGridNeeded
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats.displacement import read_displacement
from meshdeform_formats.fields import with_fields
from meshdeform_formats.grids import read_grid, write_grid
from meshdeform_formats.report.page import deformation_figures
from meshdeform_formats.series.outputs import LevelFiles

TIMES = (0.0, 0.5, 2.0)
PACKINGS = {"encoding": "fortran", "records": "plane"}, {"encoding": "binary", "byte_order": "big"}


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Blocks are cut although they are small; what a rank does not hold is no number."""
    poison_parts(monkeypatch)
    with small_blocks_are_cut(monkeypatch, 20, 2):
        yield


def same_files(tmp_path, count, act):
    """``act(folder)`` writes the same files on several ranks as in one process; returns their folder."""
    folders = [tmp_path / name for name in ("one", "ranks")]
    for folder in folders:
        folder.mkdir()
    act(folders[0])

    on_ranks(count, lambda ranks: act(folders[1], ranks))
    one, two = ({path.relative_to(at): path.read_bytes() for path in at.rglob("*") if path.is_file()} for at in folders)
    assert one
    assert two == one
    return folders[0]


def reads_and_writes(source, suffix, variant=None):
    def act(folder, ranks=ONE_PROCESS):
        grid = read_grid(source, ranks=ranks)
        write_grid(grid.moved(scaled(grid.points)), folder / f"out{suffix}", variant)

    return act


def scaled(points):
    """Other coordinates, which are exact."""
    result = Nodes.of(points).like(3)
    Nodes.of(result).each(lambda rows: np.multiply(points[rows], 2.0, out=result[rows]))
    return result


def series_of(source, name, velocity, options=None, case=None):
    """Write all levels of a series, the last one again after a fresh start."""
    case = case or Case(tuple(body_specs(turning("5*t"))), method=Options("idw-tfi"), repair=RepairOptions(mode="off"))

    def act(folder, ranks=ONE_PROCESS):
        grid = read_grid(source, ranks=ranks)
        setup, schedule = set_up(grid, case), Schedule(TIMES, velocity=velocity)
        files = LevelFiles(grid, folder, name, TIMES, options or {}, velocity)
        for first in (0, 2):
            finished = files.read if first else None
            for level in deform_series(setup, schedule, files.variant.precision, None, first, finished):
                files.write(level.number, level.result.grid, level.velocity, level.faces)
                files.publish(level.number + 1)

    return act


def test_velocities_and_swept_volumes(tmp_path):
    write_grid(frame(3, 2), tmp_path / "grid.cgns")
    same_files(tmp_path, 2, series_of(tmp_path / "grid.cgns", "wing.cgns", "swept"))


@pytest.mark.parametrize("variant", PACKINGS)
def test_plot3d_with_iblank(variant, tmp_path):
    shapes = [(9, 4, 5), (6, 7, 3)]
    (tmp_path / "grid.xyz").write_bytes(binary_file(sample_blocks(shapes), sample_iblank(shapes), **variant))
    options = {key: value for key, value in variant.items() if key == "records"}

    def act(folder, ranks=ONE_PROCESS):
        grid = read_grid(tmp_path / "grid.xyz", options, ranks)
        assert all(field.blanks for field in grid.fields)
        write_grid(grid, folder / "out.xyz")
        write_grid(grid, folder / "new.cgns")

    folder = same_files(tmp_path, 3, act)
    assert (folder / "out.xyz").read_bytes() == (tmp_path / "grid.xyz").read_bytes()


@pytest.mark.parametrize("blanked", [False, True])
def test_a_sample_of_all_ranks_decides_between_several_readings(blanked, tmp_path):
    """A plane with IBLANK or a flat block in space."""
    shape = (9, 7, 1) if blanked else (1, 9, 7)
    blocks, precision = sample_blocks([shape], "float32"), {"encoding": "binary", "precision": "float32"}
    plane = {"dimension": 2} if blanked else {"multiblock": False}
    data = binary_file(blocks, sample_iblank([shape]) if blanked else None, **precision, **plane)
    (tmp_path / "grid.bin").write_bytes(data)
    folder = same_files(tmp_path, 2, reads_and_writes(tmp_path / "grid.bin", ".bin"))
    assert read_grid(folder / "out.bin").shapes == (shape,)


@pytest.mark.parametrize("make", [frame, pytest.param(frame_2d, marks=pytest.mark.slow)])
def test_fields_at_cells_and_nodes(make, tmp_path):
    """All measures, also of cells at walls, beside interfaces and beside cuts; some cells are invalid."""
    write_grid(make(4), tmp_path / "grid.cgns")
    body = replace(body_specs(turning(100.0))[0], select=("*",))
    sides = (body,) if make is frame_2d else tuple(body_specs(turning(100.0)))
    case = Case(sides, method=Options("tfi"), repair=RepairOptions(mode="off"))

    def act(folder, ranks=ONE_PROCESS):
        setup = set_up(read_grid(tmp_path / "grid.cgns", ranks=ranks), case)
        result = impose(setup, setup.motion(0.0), 1, "float64", Timing())
        moving = np.flatnonzero(setup.boundary.quad_kind == Kind.MOVING)
        cells = CellFields(result.grid, setup.topology, setup.grid, moving, setup.original)
        write_grid(with_fields(cells, ("all", "displacement")), folder / "out.cgns")

    folder = same_files(tmp_path, 3, act)
    with h5py.File(folder / "out.cgns") as file:
        found = [file["Base/block1"][f"FlowSolution{at}"] for at in ("Vertex", "CellCenter")]
        assert {"displacementX", "GridLocation"} < set(found[0])
        assert set(CELL_MEASURES) - {"displacement"} | {"invalid"} < set(found[1])


@pytest.mark.slow
def test_pictures_of_reports(tmp_path):
    """Cuts, surfaces, the worst cells."""
    write_grid(tapered(5, 4), tmp_path / "grid.cgns")
    case = Case(tuple(body_specs(turning(50.0))), method=Options("tfi"))

    def act(folder, ranks=ONE_PROCESS):
        result = deform(read_grid(tmp_path / "grid.cgns", ranks=ranks), case)
        assert result.repair is not None
        figures = deformation_figures(result)
        assert len(figures) == 3
        for number, figure in enumerate(figures):
            (folder / f"{number}.png").write_bytes(figure.png)
            (folder / f"{number}.txt").write_text(figure.caption)

    same_files(tmp_path, 3, act)


VTK_FIELDS = ("p", "cell", ()), ("u", "node", (3,)), ("n", "node", ()), ("t", "cell", (2,))


def with_arrays(grid):
    """Arrays at nodes and cells of several types."""
    random = np.random.default_rng(3)
    fields = []
    for block, (nodes, cells) in enumerate(zip(grid.shapes, grid.cell_shapes, strict=True)):
        for name, location, rest in VTK_FIELDS:
            values = 100 * random.random((*(nodes if location == "node" else cells), *rest))
            fields.append(Field(name, location, block, values.astype("int16" if name == "n" else "float32")))
    return replace(grid, fields=tuple(fields))


@pytest.mark.parametrize(("suffix", "variant"), [(".vtm", {"precision": "float32"}), (".vts", {}), (".vtk", {})])
def test_vtk_files_with_arrays(suffix, variant, tmp_path):
    grid = frame_2d(7) if suffix == ".vts" else tapered(5, 4)
    if suffix != ".vtm":
        grid = Grid.from_blocks([grid.block(1)])
    write_grid(with_arrays(grid), tmp_path / f"grid{suffix}", variant)
    read = read_grid(tmp_path / f"grid{suffix}")
    found = {(field.name, field.block): field.values for field in read.fields}
    for field in with_arrays(grid).fields:
        np.testing.assert_array_equal(found[field.name, field.block], field.values)
    folder = same_files(tmp_path, 3, reads_and_writes(tmp_path / f"grid{suffix}", suffix))
    np.testing.assert_array_equal(read_grid(folder / f"out{suffix}").points, 2.0 * read.points)


@pytest.mark.parametrize("suffix", [".vts", ".vtk"])
def test_vtk_as_text_takes_the_whole_grid(suffix, tmp_path):
    """Said before anything is read, or written."""
    variant = {"encoding": "ascii"}
    grid = Grid.from_blocks([frame(3, 4).block(0)])
    write_grid(grid, tmp_path / f"packed{suffix}", variant)
    write_grid(grid, tmp_path / f"plain{suffix}")

    def act(ranks):
        with pytest.raises(WholeGridNeeded, match=r"packed.vt. is text"):
            read_grid(tmp_path / f"packed{suffix}", ranks=ranks)
        with pytest.raises(WholeGridNeeded, match="is written as text"):
            write_grid(read_grid(tmp_path / f"plain{suffix}", ranks=ranks), tmp_path / f"out{suffix}", variant)
        return True

    assert all(on_ranks(2, act))


def rind(whole):
    arrays = [N(f"Coordinate{'XYZ'[c]}", "DataArray_t", whole[..., c]) for c in range(3)]
    planes = N("Rind", "Rind_t", np.array([1, 2, 0, 0, 1, 2], np.int32))
    inner = zone("z", whole[1:-2, :, 1:-2])
    return replace(
        inner, children=[inner["ZoneType"], N("GridCoordinates", "GridCoordinates_t", None, [planes, *arrays])]
    )


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_cgns_with_rind_planes(precision, tmp_path):
    root = tree(rind(box(12, 5, 6)), zone("y", box(5, 4, 3)))
    write_hdf5(tmp_path / "grid.cgns", root)
    act = reads_and_writes(tmp_path / "grid.cgns", ".cgns", {"precision": precision})
    folder = same_files(tmp_path, 3, act)
    with h5py.File(folder / "out.cgns") as file:
        stored = file["Base/z/GridCoordinates/CoordinateY/ data"][()]
        expected = box(12, 5, 6)[..., 1].T.copy()
        expected[1:-2, :, 1:-2] *= 2.0
        np.testing.assert_allclose(stored, expected, rtol=1e-6)


def test_compressed_cgns_takes_the_whole_grid(tmp_path):
    write_hdf5(tmp_path / "grid.cgns", tree(zone("y", box(12, 5, 6))), dataset={"chunks": True, "compression": "gzip"})

    def act(ranks):
        with pytest.raises(WholeGridNeeded, match="are compressed or stored in pieces"):
            read_grid(tmp_path / "grid.cgns", ranks=ranks)
        return True

    assert all(on_ranks(2, act))


def test_values_of_a_field_are_not_taken_for_those_of_all_ranks(tmp_path):
    shape = (9, 4, 5)
    (tmp_path / "grid.xyz").write_bytes(binary_file(sample_blocks([shape]), sample_iblank([shape]), encoding="binary"))

    def act(ranks):
        (field,) = read_grid(tmp_path / "grid.xyz", ranks=ranks).fields
        assert field.values.shape == shape
        assert field.own.shape[0] < shape[0]
        with pytest.raises(WholeGridNeeded, match="all values of a field"):
            np.asarray(field.values)
        return True

    assert all(on_ranks(2, act))


@pytest.mark.skipif(not hasattr(os, "O_DSYNC"), reason="no synchronous writing here")
def test_ranks_on_several_machines_write_levels_synchronously(tmp_path, monkeypatch):
    write_grid(frame(3, 2), tmp_path / "grid.xyz")
    opened, begin = [], os.open

    def recorded(path, flags, *args, **kwargs):
        if "out" in os.path.basename(path) and flags & os.O_WRONLY:
            opened.append(bool(flags & os.O_DSYNC))
        return begin(path, flags, *args, **kwargs)

    monkeypatch.setattr(os, "open", recorded)

    def act(ranks):
        reads_and_writes(tmp_path / "grid.xyz", ".xyz")(tmp_path, ranks)
        return opened

    for found in on_ranks(2, act):
        assert set(found) == {True}


def test_every_rank_reads_deformed_positions_as_a_whole(tmp_path):
    grid = frame(4, 3)
    for name, points in (("grid", grid.points), ("bent", grid.points + 0.02 * grid.points[:, ::-1] ** 2)):
        write_grid(grid.moved(points), tmp_path / f"{name}.xyz")
    step = Follow(read_displacement(tmp_path / "bent.xyz"), Matching("exact"))
    case = Case((BoundarySpec("all", ("*",), Kind.MOVING, motion=Motion((step,), {})),))

    def act(folder, ranks=ONE_PROCESS):
        result = deform(read_grid(tmp_path / "grid.xyz", ranks=ranks), case)
        write_grid(result.grid, folder / "out.xyz")

    same_files(tmp_path, 2, act)
