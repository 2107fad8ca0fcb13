"""Third-party grids: every file reads to the oracle and survives every variant of every writable format.

The oracle holds the coordinates as independent readers found them (see the manifest beside the grids).
"""

from __future__ import annotations

import itertools
from pathlib import Path

import meshio
import numpy as np
import pytest

from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality.cells import block_volumes
from meshdeform_formats import read_grid, write_grid

NAMES = (
    "717_wl_L2.cgns", "717_wl_L2_hdf5.cgns", "nak_a_141.cgns", "nak_a_141.p3dfmt", "cylinder_ring_4blk.x",
    "backstep5_4levdn.p3dbin", "shear_3blk_2d.p2dfmt", "StructuredGrid.vts", "SampleStructGrid.vtk",
)  # fmt: skip
EACH = pytest.mark.parametrize("name", NAMES)
FEW = ("backstep5_4levdn.p3dbin", "shear_3blk_2d.p2dfmt", "StructuredGrid.vts")
"""One of several blocks, one in the plane, one block."""

PLOT3D = [
    {"encoding": "ascii"},
    *({"encoding": "binary", "byte_order": order} for order in ("little", "big")),
    *(
        {"encoding": "fortran", "byte_order": order, "markers": markers, "records": records}
        for order, markers, records in itertools.product(("little", "big"), (4, 8), ("block", "array", "plane"))
    ),
]
VTK = {
    ".vtk": [{"encoding": "ascii"}, {"encoding": "binary"}],
    ".vts": [{"compression": "none"}, {"compression": "zlib"}, {"encoding": "ascii"}],
}


def oracle(folder: Path, name: str) -> list[np.ndarray]:
    values = np.load(folder / "oracle" / f"{name.replace('_hdf5', '')}.npz", allow_pickle=False)
    return [values[f"b{n}"] for n in range(sum(key[0] == "b" for key in values))]


def assert_same(grid: Grid, known: list[np.ndarray]) -> None:
    assert grid.shapes == tuple(block.shape[:3] for block in known)
    for number, block in enumerate(known):
        np.testing.assert_array_equal(grid.block(number), block)


@EACH
def test_file_is_read_as_its_oracle(name, third_party):
    assert_same(read_grid(third_party / name), oracle(third_party, name))


@pytest.mark.slow
@EACH
def test_every_plot3d_variant_and_back(name, third_party, tmp_path):
    known, grid = oracle(third_party, name), read_grid(third_party / name)
    for number, options in enumerate(PLOT3D):
        path = tmp_path / f"{number}.xyz"
        write_grid(grid, path, {**options, "precision": "float64"})
        again = read_grid(path)
        assert_same(again, known)
        assert again.format is not None
        # The one plane of a 2-D block is the whole block.
        if not (grid.dimension == 2 and options.get("records") == "plane"):
            assert again.format.options.items() >= options.items()
        back = write_grid(again, tmp_path / f"{number}-back{Path(name).suffix}")
        assert_same(read_grid(tmp_path / f"{number}-back{Path(name).suffix}"), known)
        assert back.precision == "float64"


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in FEW else pytest.mark.slow) for n in NAMES])
@pytest.mark.parametrize("suffix", VTK)
def test_every_vtk_variant_and_back(name, suffix, third_party, tmp_path):
    known, grid = oracle(third_party, name), read_grid(third_party / name)
    target = suffix if grid.n_blocks == 1 else ".vtm"
    variants = VTK[suffix] if target == suffix else VTK[".vts"][: 2 if suffix == ".vtk" else 6]
    for number, options in enumerate(variants):
        path = tmp_path / f"{number}{target}"
        write_grid(grid, path, options)
        again = read_grid(path)
        assert_same(again, known)
        assert again.precision == grid.precision
        write_grid(again, tmp_path / f"{number}.cgns")
        assert_same(read_grid(tmp_path / f"{number}.cgns"), known)


EXPORTS = (
    (".vtu", {}), (".vtu", {"boundary": "true"}), (".su2", {}), (".msh", {}), (".msh", {"encoding": "ascii"}),
    (".inp", {}), (".xdmf", {}), (".med", {}),
)  # fmt: skip


# Every format with a grid of several blocks and with one in the plane, every grid in one format.
@pytest.mark.parametrize(
    ("name", "suffix", "options"),
    [
        pytest.param(name, *export, marks=() if name in FEW or export == (".vtu", {}) else pytest.mark.slow)
        for name in NAMES
        for export in EXPORTS
    ],
    ids=str,
)
def test_unstructured_export_holds_every_cell_and_point(name, suffix, options, third_party, tmp_path):
    """Read back by meshio: as many cells as the blocks have, at the oracle's points, each once."""
    grid = read_grid(third_party / name)
    path = tmp_path / f"grid{suffix}"
    write_grid(grid, path, options)
    mesh = meshio.read(path)
    kind = "quad" if grid.dimension == 2 else "hexahedron"
    cells = np.concatenate([block.data for block in mesh.cells if block.type == kind])
    volume = cells[: grid.n_cells]
    assert len(volume) == grid.n_cells
    topology = find_topology(grid)
    n_unique = grid.n_nodes - len(topology.face_nodes) + topology.n_unique
    assert len(mesh.points) == n_unique
    points = np.zeros((n_unique, 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    known = np.concatenate([block.reshape(-1, 3) for block in oracle(third_party, name)])
    assert np.isin(_as_rows(points), _as_rows(known)).all()


@EACH
def test_vtk_reads_the_volume_of_every_grid(name, third_party, tmp_path):
    """The sum over the cells of the .vtu file by the vtk package is that of the blocks."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    grid = read_grid(third_party / name)
    write_grid(grid, tmp_path / "grid.vtu")
    reader, sizes = vtkXMLUnstructuredGridReader(), vtkCellSizeFilter()
    reader.SetFileName(str(tmp_path / "grid.vtu"))
    sizes.SetInputConnection(reader.GetOutputPort())
    sizes.Update()
    which = "Area" if grid.dimension == 2 else "Volume"
    found = vtk_to_numpy(sizes.GetOutput().GetCellData().GetArray(which))
    assert len(found) == grid.n_cells
    if grid.dimension == 3:
        assert (found > 0).all()
        total = np.abs(block_volumes(grid, grid.points, np.ones(grid.n_blocks))).sum()
        assert found.sum() == pytest.approx(total, rel=1e-3)


def _as_rows(points: np.ndarray) -> np.ndarray:
    """Points as single values that are equal when all their coordinates are."""
    rounded = np.ascontiguousarray(points.astype(np.float32) + np.float32(0.0))
    return rounded.view([("", np.float32)] * 3).ravel()
