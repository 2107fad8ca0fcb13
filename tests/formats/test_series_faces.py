"""What cell faces sweep, in the files of a series: read back by h5py and VTK, and summed up cell by cell."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import vtk_witness
from cgns_witness import assert_cgnscheck_finds_no_error
from grids import frame, frame_2d
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOLegacy import vtkStructuredGridReader
from vtkmodules.vtkIOXML import vtkXMLStructuredGridReader

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_core.velocity import at_faces, face_fields, grid_velocity, swept_volumes
from meshdeform_formats import read_grid
from meshdeform_formats.series.outputs import LevelFiles

TIMES = (0.0, 0.5, 2.0)
AXES = "IJK"


def at(grid: Grid, number: int) -> np.ndarray:
    wave = np.sin(grid.points @ [[1.0, 2.0, 0.0], [0.5, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return grid.points + 0.03 * number**2 * wave * [1.0, 1.0, 0.0]


def written(grid: Grid, folder, name: str, kind=LevelFiles, precision: str = "float64"):
    files = kind(grid, folder, name, TIMES, {"precision": precision}, "swept")
    points: list[np.ndarray] = []
    for number in range(len(TIMES)):
        points = [*points, at(grid, number)][-3:]
        times = TIMES[: number + 1]
        faces = face_fields(grid, times, points)
        files.write(number, grid.moved(points[-1]), grid_velocity(times, points, "swept"), faces)
        files.publish(number + 1)
    return files


def expected(grid: Grid, number: int) -> list[tuple[np.ndarray, ...]]:
    return at_faces(grid, swept_volumes(grid, at(grid, number - 1), at(grid, number)))


@pytest.mark.parametrize("make", [frame, frame_2d])
def test_cgns_levels_have_face_centred_solutions(make, tmp_path):
    grid = make()
    files = written(grid, tmp_path, "wing.cgns")
    with h5py.File(files.path(2)) as file:
        for block, name in enumerate(grid.names):
            for axis, values in zip(AXES, expected(grid, 2)[block], strict=True):
                if not values.size:
                    assert f"FlowSolution{axis}FaceCenter" not in file["Base"][name]
                    continue
                solution = file["Base"][name][f"FlowSolution{axis}FaceCenter"]
                assert solution["GridLocation/ data"][()].tobytes() == f"{axis}FaceCenter".encode()
                stored = solution["SweptVolume/ data"][()].T
                np.testing.assert_array_equal(stored.reshape(values.shape), values)
                assert solution["VolumeFlux/ data"].shape == solution["SweptVolume/ data"].shape
    assert_cgnscheck_finds_no_error(files.path(2))


def test_flat_axis_of_a_block_is_no_axis_of_its_zone(tmp_path):
    """The faces across j of a block that is flat in i are those across the first axis of its CGNS zone."""
    grid = Grid.from_blocks([frame_2d().block(0).transpose(2, 0, 1, 3).copy()], ["only"])
    files = written(grid, tmp_path, "flat.cgns")
    with h5py.File(files.path(1)) as file:
        stored = file["Base/only/FlowSolutionIFaceCenter/SweptVolume/ data"][()].T
        np.testing.assert_array_equal(stored, expected(grid, 1)[0][1][0])
        assert "FlowSolutionKFaceCenter" not in file["Base/only"]


@pytest.mark.parametrize("suffix", [".vts", ".vtk"])
def test_vtk_levels_have_field_data_with_i_fastest(suffix, tmp_path):
    grid = Grid.from_blocks([frame().block(2)], ["only"])
    files = written(grid, tmp_path, f"wing{suffix}")
    reader = vtkXMLStructuredGridReader() if suffix == ".vts" else vtkStructuredGridReader()
    reader.SetFileName(str(files.path(2)))
    reader.Update()
    data = reader.GetOutput().GetFieldData()
    for axis, values in zip(AXES, expected(grid, 2)[0], strict=True):
        run = vtk_to_numpy(data.GetArray(f"SweptVolume{axis}"))
        np.testing.assert_array_equal(run.reshape(values.shape[::-1]).swapaxes(0, 2), values)
        assert data.GetArray(f"VolumeFlux{axis}").GetNumberOfTuples() == values.size
    # A series that starts from a level replaces what that level swept.
    again = read_grid(files.path(2))
    other = written(again, tmp_path, f"again{suffix}")
    _, arrays, _ = vtk_witness.read(other.path(0))
    assert len([name for _, name in arrays if name == "SweptVolumeI"]) <= 1
    reader.SetFileName(str(other.path(0)))
    reader.Update()
    assert not vtk_to_numpy(reader.GetOutput().GetFieldData().GetArray("SweptVolumeI")).any()


def test_swept_volumes_keep_double_precision(tmp_path):
    grid = Grid.from_blocks([frame().block(2)], ["only"])
    files = written(grid, tmp_path, "wing.cgns", precision="float32")
    with h5py.File(files.path(1)) as file:
        assert file["Base/only/FlowSolutionIFaceCenter/SweptVolume/ data"].dtype == np.float64
        assert file["Base/only/FlowSolutionVertex/GridVelocityX/ data"].dtype == np.float32


@pytest.mark.parametrize("suffix", [".vtu", ".xyz"])
def test_formats_without_faces_are_refused(suffix, tmp_path):
    with pytest.raises(FormatError, match="cannot hold values at cell faces"):
        LevelFiles(Grid.from_blocks([frame().block(2)]), tmp_path, f"wing{suffix}", TIMES, {}, "swept")
