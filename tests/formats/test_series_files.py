"""Levels on disk: velocities, what cell faces sweep, indices of ParaView; read back by h5py and VTK."""

import dataclasses
import hashlib
import json
import os
import re
import subprocess
from importlib.metadata import version
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import vtk_witness
from cgns_witness import assert_cgnscheck_finds_no_error
from grids import frame, frame_2d
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOLegacy import vtkStructuredGridReader
from vtkmodules.vtkIOParallel import vtkPlot3DMetaReader
from vtkmodules.vtkIOXML import vtkXMLStructuredGridReader

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import Grid
from meshdeform_core.series import REVISION, Schedule
from meshdeform_core.velocity import face_fields, grid_velocity, swept_volumes
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.case import case_of
from meshdeform_formats.files import partial_path, remove_partial, replacing
from meshdeform_formats.grids import variant_of
from meshdeform_formats.inputs import bytes_at, least_bytes, velocity_bytes
from meshdeform_formats.series.manifest import Manifest, ingredients_of
from meshdeform_formats.series.outputs import FoamFiles, LevelFiles

TIMES = (0.0, 0.5, 2.0)
MOVES = [{"at": [1, 1, 1], "by": [0, 0, "t"]}]


def at(grid: Grid, time: float) -> Grid:
    """The grid sheared by the time squared, so that its velocity is (2 t y, 0, 0)."""
    return grid.moved(grid.points + np.outer(time**2 * grid.points[:, 1], [1.0, 0.0, 0.0]))


def velocity(grid: Grid, time: float) -> np.ndarray:
    return np.outer(2 * time * grid.points[:, 1], [1.0, 0.0, 0.0])


def one_block() -> Grid:
    return Grid.from_blocks([frame().block(2)], ["only"])


def written(grid: Grid, folder: Path, name: str, order="second", options=None):
    files = LevelFiles(grid, folder, name, TIMES, options or {}, order)
    for number, time in enumerate(TIMES):
        files.write(number, at(grid, time), None if order == "none" else velocity(grid, time))
        files.publish(number + 1)
    return files


def test_all_that_a_series_depends_on_by_name(tmp_path):
    """Options of the method and of repairs that are not given, too; lists of tables and of lists by number."""
    for name in ("g.xyz", "a.csv", "m.nmf", "n.nmf"):
        (tmp_path / name).write_text("0,0,0,0,0,0\n")
    lattice = {"origin": [0, 0, 0], "edges": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "points": [2, 2, 2]}
    content = {
        "boundary": [{"motion": {"file": "a.csv"}}, {"name": "b", "motion": [{"ffd": lattice | {"move": MOVES}}]}],
        "method": {"name": "rbf", "idw": {"alpha": 0.5}}, "repair": {"mode": "off"},
        "grid": {"tolerance": 0.01, "boundary_file": "n.nmf"},
    }  # fmt: skip
    case = case_of(content, tmp_path)
    schedule = Schedule((0.0, 1.0), "first", 3)
    found = ingredients_of(tmp_path / "g.xyz", tmp_path / "m.nmf", case, schedule, {"suffix": ".vts"})
    same = hashlib.sha256(b"0,0,0,0,0,0\n").hexdigest()
    options = {f"method.rbf.{key}": value for key, value in dataclasses.asdict(case.case.method.rbf).items()}
    options |= {f"repair.{key}": value for key, value in dataclasses.asdict(case.case.repair).items()}
    ffd = "case boundary.2.motion.1.ffd"
    assert found == {
        "program": f"meshdeform {version('meshdeform')}", "algorithms": REVISION, "grid": same,
        **{f"file {tmp_path / name}": same for name in ("m.nmf", "n.nmf", "a.csv")},
        "case boundary.2.name": "b", "case grid.boundary_file": "n.nmf", "case grid.tolerance": 0.01,
        f"{ffd}.origin": [0, 0, 0], **{f"{ffd}.edges.{n + 1}": row for n, row in enumerate(lattice["edges"])},
        f"{ffd}.points": [2, 2, 2], f"{ffd}.move.1.at": [1, 1, 1], f"{ffd}.move.1.by": [0, 0, "t"],
        "case boundary.1.motion.file": "a.csv",
        "method.name": "rbf", "tolerance": 0.01, "times": (0.0, 1.0), "velocity": "first",
        "steps": 3, "suffix": ".vts", **{key: "inf" if value == np.inf else value for key, value in options.items()},
    }  # fmt: skip
    Manifest(tmp_path / "series.json", found).save()
    begun = Manifest.load(tmp_path / "series.json")
    begun.require_same(found)
    changed = {key: value for key, value in found.items() if key != "suffix"}
    changed |= {"times": tuple(np.arange(6.0)), "new": [1] * 4, "grid": "0", f"file {tmp_path / 'a.csv'}": "0"}
    with pytest.raises(CaseError) as error:
        begun.require_same(changed)
    assert re.sub(r"file \S*/", "file ", str(error.value)).endswith(
        "grid has different contents; file a.csv has different contents; times was [0.0, 1.0], is 6 values from 0.0 to "
        "5.0; suffix was removed (was '.vts'); new is new ([1, 1, 1, 1]). Undo that, write to another folder, or "
        "restart it (--force)")  # fmt: skip


def test_fields_join_a_copy_beside_what_it_holds(tmp_path):
    """A second run replaces its own solution; other solutions of the same name stay."""
    write_grid(one_block(), tmp_path / "grid.cgns")
    written(read_grid(tmp_path / "grid.cgns"), tmp_path, "wing.cgns")
    again = read_grid(tmp_path / "wing_0002.cgns")
    LevelFiles(again, tmp_path, "again.cgns", TIMES, {}, "first").write(0, again, 0 * again.points)
    with h5py.File(tmp_path / "again_0000.cgns") as file:
        assert [name for name in file["Base/only"] if "Solution" in name] == ["FlowSolutionVertex"]
        assert not file["Base/only/FlowSolutionVertex/GridVelocityX/ data"][()].any()
    with h5py.File(tmp_path / "wing_0002.cgns", "r+") as file:
        file.move("Base/only/FlowSolutionVertex/GridVelocityZ", "Base/only/FlowSolutionVertex/Pressure")
    again = read_grid(tmp_path / "wing_0002.cgns")
    LevelFiles(again, tmp_path, "other.cgns", TIMES, {}, "first").write(0, again, 0 * again.points)
    with h5py.File(tmp_path / "other_0000.cgns") as file:
        assert "Pressure" in file["Base/only/FlowSolutionVertex"]
        assert "GridVelocityZ" in file["Base/only/FlowSolutionVertex_2"]


@pytest.mark.parametrize("suffix", [".xyz", ".su2"])
def test_formats_without_fields_refuse_velocities(suffix, tmp_path):
    with pytest.raises(FormatError, match="cannot hold the grid velocity"):
        LevelFiles(frame(), tmp_path, f"wing{suffix}", TIMES, {}, "first")
    with pytest.raises(FormatError, match="cannot hold values at cell faces"):
        LevelFiles(one_block(), tmp_path, f"wing{'.vtu' if suffix == '.su2' else suffix}", TIMES, {}, "swept")


@pytest.mark.parametrize("suffix", [".vtm", ".vtk", ".cgns"])
def test_indices_name_times_and_files(suffix, tmp_path):
    files = written(frame() if suffix == ".vtm" else one_block(), tmp_path, f"wing{suffix}", order="none")
    assert files.view == tmp_path / ("wing.pvd" if suffix == ".vtm" else f"wing{suffix}.series")
    if suffix == ".vtm":
        entries = ElementTree.parse(files.view).getroot().findall("Collection/DataSet")
        found = {float(entry.get("timestep")): entry.get("file") for entry in entries}
    else:
        content = json.loads(files.view.read_text())
        assert content["file-series-version"] == "1.0"
        found = {entry["time"]: entry["name"] for entry in content["files"]}
    assert found == {time: files.path(n).name for n, time in enumerate(TIMES)}
    assert all(files.path(n).is_file() for n in range(3))


STORED = [
    (frame, {"encoding": "ascii"}, ["ascii", "little", 64, True, "C", False, False]),
    (frame, {"byte_order": "big", "precision": "float32"}, ["binary", "big", 32, True, "fortran", False, False]),
    (one_block, {"encoding": "binary", "multiblock": False, "iblank": True},
     ["binary", "little", 64, False, "C", True, False]),
    (frame_2d, {"encoding": "binary", "dimension": 2}, ["binary", "little", 64, True, "C", False, True]),
]  # fmt: skip


@pytest.mark.parametrize(("make", "options", "stored"), STORED)
def test_vtk_reads_a_plot3d_series_through_its_index(make, options, stored, tmp_path):
    grid = make()
    files = written(grid, tmp_path, "wing.xyz", "none", options)
    assert [*json.loads(files.view.read_text()).values()][1:-1] == stored
    reader = vtkPlot3DMetaReader()
    reader.SetFileName(str(files.view))
    reader.UpdateInformation()
    assert reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS()) == pytest.approx(TIMES)
    for time in (2.0, 0.5):
        reader.UpdateTimeStep(time)
        found = reader.GetOutput()
        assert found.GetNumberOfBlocks() == grid.n_blocks
        for block, shape in enumerate(grid.shapes):
            # The first index of VTK runs fastest.
            points = vtk_to_numpy(found.GetBlock(block).GetPoints().GetData()).reshape(*shape[::-1], 3).swapaxes(0, 2)
            np.testing.assert_allclose(points, at(grid, time).block(block), rtol=0, atol=1e-6)


def test_names_and_room_of_levels(tmp_path):
    """Levels that are replaced leave room, but one has to be complete before it replaces another."""
    files = LevelFiles(one_block(), tmp_path, "w.vts", TIMES, {}, "none")
    size = 24 * files.grid.n_nodes
    assert [files.least_bytes(first) for first in range(4)] == [3 * size, 2 * size, size, 0]
    written(one_block(), tmp_path, "w.vts", "none")
    assert [files.least_bytes(first) for first in range(4)] == [size, size, size, 0]
    swept = LevelFiles(one_block(), tmp_path, "v.vts", TIMES, {}, "swept")
    assert swept.least_bytes(2) == 2 * size + 3 * 16 * files.grid.n_cells
    for count, name in ((10000, "w_0007.vts"), (10001, "w_00007.vts")):
        assert LevelFiles(one_block(), tmp_path, "w.vts", (0.0,) * count, {}, "none").names(7)[0].name == name


def test_levels_of_openfoam_are_folders_of_their_times(tmp_path):
    """An invalid level is no time; when it is written anew as a valid one, it is gone."""
    times = (0.0, 1.0000001, 1.0000002)
    files = FoamFiles(frame(), tmp_path / "case", "a.foam", times, {}, "none")
    assert [files.names(n)[0].name for n in range(3)] == ["0", "1.0000001", "1.0000002"]
    for record, invalid in (("1.0000001.invalid", True), ("1.0000001", False)):
        files.recall([{"file": "0"}, {"file": record}])
        files.write(1, at(frame(), 1.0), None)
        assert [path.exists() for path in files.names(1)] == [not invalid, invalid]
        assert [files.has(n) for n in range(3)] == [False, True, False]
    np.testing.assert_array_equal(files.read(1), at(frame(), 1.0).points)
    with pytest.raises(FormatError, match="omit --velocity"):
        FoamFiles(frame(), tmp_path / "case", "a.foam", times, {}, "first")


NODES, PLANE, BLOCK = 1152, 392, 100
VARIANTS = {
    "c.p3dbin": ({"encoding": "binary"}, 24 * NODES), "plane.p2dbin": ({}, 16 * PLANE), "grid.vts": ({}, 24 * BLOCK),
    "single.cgns": ({"precision": "float32"}, 12 * NODES), "text.vts": ({"encoding": "ascii"}, 0), "mesh.vtu": ({}, 0),
    "new.cgns": ({}, 24 * NODES), "blocks.vtm": ({}, 24 * NODES), "plane.vtk": ({}, 24 * 36), "text.p3dfmt": ({}, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", VARIANTS)
def test_no_file_is_smaller_than_foretold(name, tmp_path):
    grid = frame_2d() if name.startswith("plane") else frame()
    if name.endswith((".vts", ".vtk")):
        grid = type(grid).from_blocks([grid.block(0)])
    path, (options, expected) = tmp_path / name, VARIANTS[name]
    assert least_bytes(grid, path, variant_of(grid, path, options)) == expected
    write_grid(grid, path, options)
    assert expected <= bytes_at(path) == sum(file.stat().st_size for file in tmp_path.rglob("*.*"))
    levels = LevelFiles(grid, tmp_path, f"w{path.suffix}", TIMES, options, "none")
    assert [levels.least_bytes(first) for first in range(4)] == [3 * expected, 2 * expected, expected, 0]
    assert velocity_bytes(grid, "swept", "float32") == grid.dimension * (4 * grid.n_nodes + 16 * grid.n_cells)
    if name == "single.cgns":
        # A copy, whose coordinates may be compressed.
        half = variant_of(read_grid(path), path, {"precision": "float64"})
        assert least_bytes(read_grid(path), path, half) == bytes_at(path) // 2


@pytest.mark.parametrize("clean", [remove_partial, lambda folder: partial_path(folder / "wing.xyz")])
def test_what_another_program_is_writing_stays(clean, tmp_path, monkeypatch):
    """Only processes that no longer run leave files behind; the name says which process writes."""
    with replacing(tmp_path / "wing.xyz") as partial, subprocess.Popen(["sleep", "60"]) as other:
        partial.write_text("x")
        theirs, gone = (
            partial.with_name(partial.name.replace(f".{os.getpid()}-", f".{n}-")) for n in (other.pid, 2**22)
        )
        name = gone.name.split("-")
        elsewhere = gone.with_name(f"{name[0]}-{'0' if name[1][0] > '0' else '1'}{name[1][1:]}")
        for path in (theirs, gone, elsewhere):
            path.write_text("x")
        clean(tmp_path)
        # Whether the process of another machine runs is unknown.
        assert elsewhere.exists() == (clean is not remove_partial)
        assert (partial.exists(), theirs.exists(), gone.exists()) == (True, True, False)
        other.kill()
        other.wait()
        # A process of another user counts as running.
        monkeypatch.setattr(os, "kill", Mock(side_effect=PermissionError))
        clean(tmp_path)
        assert theirs.exists()


def test_what_a_killed_program_left_is_removed_and_nothing_else(tmp_path):
    files = written(one_block(), tmp_path, "wing.vtm", order="none")
    left = [".wing_0001.123-0a1b2c3d.partial.vtm", ".series.9-00000000.partial.json"]
    mine = ["notes.txt", ".hidden.partial", "wing_0009"]
    for name in left + mine:
        (tmp_path / name).write_text("x")
    staging = tmp_path / ".wing_0001.123-0a1b2c3d.partial"
    (staging / "new").mkdir(parents=True)
    files.path(2).unlink()
    files.clean()
    assert not staging.exists()
    assert not any((tmp_path / name).exists() for name in left)
    assert all((tmp_path / name).exists() for name in mine)
    # Pieces without their index would be in the way of the level that is made anew.
    assert [files.has(n) for n in range(3)] == [True, True, False]
    assert [files.path(n).with_suffix("").exists() for n in range(3)] == [True, True, False]


AXES = "IJK"


def wavy(grid: Grid, number: int) -> np.ndarray:
    wave = np.sin(grid.points @ [[1.0, 2.0, 0.0], [0.5, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return grid.points + 0.03 * number**2 * wave * [1.0, 1.0, 0.0]


def swept(grid: Grid, folder, name: str, precision: str = "float64"):
    files = LevelFiles(grid, folder, name, TIMES, {"precision": precision}, "swept")
    points: list[np.ndarray] = []
    for number in range(len(TIMES)):
        points = [*points, wavy(grid, number)][-3:]
        times = TIMES[: number + 1]
        faces = face_fields(grid, times, points)
        files.write(number, grid.moved(points[-1]), grid_velocity(times, points, "swept"), faces)
        files.publish(number + 1)
    return files


def expected(grid: Grid, number: int) -> list[tuple[np.ndarray, ...]]:
    return swept_volumes(grid, wavy(grid, number - 1), wavy(grid, number))


def rate(grid: Grid) -> np.ndarray:
    """The velocity of the last level."""
    return (wavy(grid, 2) - wavy(grid, 1)) / (TIMES[2] - TIMES[1])


@pytest.mark.parametrize(("make", "precision", "copied"), [(frame, "float32", True), (frame_2d, "float64", False)])
def test_cgns_levels_have_solutions_at_nodes_and_faces(make, precision, copied, tmp_path):
    """What faces sweep keeps double precision."""
    grid = make()
    if copied:
        write_grid(grid, tmp_path / "grid.cgns")
        grid = read_grid(tmp_path / "grid.cgns")
    files = swept(grid, tmp_path, "wing.cgns", precision)
    np.testing.assert_allclose(files.read(2), wavy(grid, 2), rtol=0, atol=1e-6)
    with h5py.File(files.path(2)) as file:
        for block, name in enumerate(grid.names):
            nodes = file["Base"][name]["FlowSolutionVertex"]
            assert nodes.attrs["label"].decode() == "FlowSolution_t"
            velocities = grid.block(block, rate(grid))
            for n, axis in enumerate("XYZ"[: grid.dimension]):
                stored = nodes[f"GridVelocity{axis}/ data"][()].T
                assert stored.dtype == precision
                np.testing.assert_allclose(stored.reshape(velocities.shape[:3]), velocities[..., n], rtol=0, atol=1e-6)
            for axis, values in zip(AXES, expected(grid, 2)[block], strict=True):
                if not values.size:
                    assert f"FlowSolution{axis}FaceCenter" not in file["Base"][name]
                    continue
                solution = file["Base"][name][f"FlowSolution{axis}FaceCenter"]
                assert solution["GridLocation/ data"][()].tobytes() == f"{axis}FaceCenter".encode()
                stored = solution["SweptVolume/ data"][()].T
                np.testing.assert_array_equal(stored.reshape(values.shape), values)
                assert stored.dtype == np.float64
                assert solution["VolumeFlux/ data"].shape == solution["SweptVolume/ data"].shape
    assert_cgnscheck_finds_no_error(files.path(2))


def test_flat_axis_of_a_block_is_no_axis_of_its_zone(tmp_path):
    """The faces across j of a block that is flat in i are those across the first axis of its CGNS zone."""
    grid = Grid.from_blocks([frame_2d().block(0).transpose(2, 0, 1, 3).copy()], ["only"])
    files = swept(grid, tmp_path, "flat.cgns")
    with h5py.File(files.path(1)) as file:
        stored = file["Base/only/FlowSolutionIFaceCenter/SweptVolume/ data"][()].T
        np.testing.assert_array_equal(stored, expected(grid, 1)[0][1][0])
        assert "FlowSolutionKFaceCenter" not in file["Base/only"]


@pytest.mark.parametrize("suffix", [".vts", ".vtk"])
def test_vtk_levels_have_point_data_and_field_data_with_i_fastest(suffix, tmp_path):
    grid = one_block()
    files = swept(grid, tmp_path, f"wing{suffix}")
    points, arrays = vtk_witness.read(files.path(2))
    np.testing.assert_array_equal(points, grid.block(0, wavy(grid, 2)))
    np.testing.assert_allclose(arrays["node", "GridVelocity"], grid.block(0, rate(grid)), rtol=0, atol=1e-14)
    reader = vtkXMLStructuredGridReader() if suffix == ".vts" else vtkStructuredGridReader()
    reader.SetFileName(str(files.path(2)))
    reader.Update()
    data = reader.GetOutput().GetFieldData()
    for axis, values in zip(AXES, expected(grid, 2)[0], strict=True):
        run = vtk_to_numpy(data.GetArray(f"SweptVolume{axis}"))
        np.testing.assert_array_equal(run.reshape(values.shape[::-1]).swapaxes(0, 2), values)
        assert data.GetArray(f"VolumeFlux{axis}").GetNumberOfTuples() == values.size
    # A series that starts from a level replaces its velocity and what it swept.
    other = swept(read_grid(files.path(2)), tmp_path, f"again{suffix}")
    _, arrays = vtk_witness.read(other.path(0))
    assert list(arrays) == [("node", "GridVelocity")]
    assert not arrays["node", "GridVelocity"].any()
    reader.SetFileName(str(other.path(0)))
    reader.Update()
    assert not vtk_to_numpy(reader.GetOutput().GetFieldData().GetArray("SweptVolumeI")).any()
