"""Damage of every readable format: a file is read or refused with a message, never anything else."""

import warnings
import zipfile

import h5py
import numpy as np
import pytest

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.displacement import read_displacement
from meshdeform_formats.grids import require_earlier_grid

POINTS = np.random.default_rng(0).random((10, 3))


def zipped(path, **members):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name.replace("_", "."), data)


def npy(values, folder):
    np.save(folder / "one.npy", values)
    return (folder / "one.npy").read_bytes()


def test_archives_that_are_no_tables(tmp_path):
    good, path = npy(POINTS, tmp_path), tmp_path / "a.npz"
    huge = good.replace(b"(10, 3), }         ", b"(1000000000, 3), } ")
    for members, message in (
        ({"points_npy": good, "notes_txt": b"mine"}, r"its member 'notes\.txt' is not an array"),
        ({"points_npy": b"mine", "displacement_npy": good}, "its member 'points' is not an array"),
        ({"points_npy": good[:-8], "displacement_npy": good}, "reading array data, expected 240 bytes got 232"),
        ({"points_npy": good.replace(b"(10, 3), }         ", b"(10**9, 3), }      ")}, "cannot read"),
        ({"points_npy": huge, "displacement_npy": good}, "EOF: reading array data|Unable to allocate"),
    ):
        zipped(path, **members)
        with pytest.raises(FormatError, match=message) as error:
            read_displacement(path)
        assert "a.npz" in str(error.value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with zipfile.ZipFile(path, "w") as archive:
            for name in ("points", "displacement", "points"):
                archive.writestr(f"{name}.npy", good)
    with pytest.raises(FormatError, match="it has several arrays of the same name: displacement, points, points"):
        read_displacement(path)
    zipped(path, points_npy=good, displacement_npy=good)
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"'points\.npy' is encrypted, password required"):
        read_displacement(path)
    (tmp_path / "b.npy").write_bytes(huge)
    with pytest.raises(FormatError, match=r"cannot read .*b\.npy"):
        read_displacement(tmp_path / "b.npy")


def test_hdf5_tables_that_announce_too_much_or_lead_in_circles(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("points", (10**9, 3), "f8", chunks=(1000, 3))
        file["displacement"] = POINTS
    with pytest.raises(FormatError, match=r"/points declares \(1000000000, 3\) float64 values; only 0 bytes"):
        read_displacement(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["round"] = h5py.SoftLink("/round")
        file["above"] = file["/"]
        file["outside"] = h5py.ExternalLink("b.h5", "/outside")
        file["gone"] = h5py.ExternalLink("gone.h5", "/x")
        file.create_group("table")["points"] = POINTS
        file["table/displacement"] = POINTS
        file["table/again"] = h5py.SoftLink("/table")
    np.testing.assert_array_equal(read_displacement(tmp_path / "b.h5").points, POINTS)


@pytest.mark.parametrize("name", ["a.xyz", "a.fmt", "a.vts", "a.vtk", "a.cgns"])
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1e200], r"has 1 nodes whose coordinates are beyond 1e\+30; the first is block1 \(2, 1, 1\)"),
        ([-np.inf], "has 1 nodes whose coordinates are not finite numbers"),
        ([-1e-310], r"4% of the coordinates are smaller than any normal number \(1e-310\)"),
        (np.full(24, 3.0), r"all 8 nodes lie at one point, \(3, 3, 3\); a grid needs at least a surface"),
        (np.outer(np.arange(8.0), [1, 2, 0]).ravel(), "all 8 nodes lie on one line; a grid needs at least a surface"),
    ],
)
def test_coordinates_that_cannot_be_meant(tmp_path, name, values, message):
    points = np.random.default_rng(0).random((2, 2, 2, 3))
    points[1, 0, 0, 0] = values[0]
    if len(values) > 1:
        points = np.asarray(values).reshape(2, 2, 2, 3)
    write_grid(Grid.from_blocks([points]), tmp_path / name)
    with pytest.raises(
        (GridError, FormatError), match=f"{message}|would be implausible" if name == "a.xyz" else message
    ):
        read_grid(tmp_path / name)


@pytest.mark.parametrize("name", ["a.xyz", "a.fmt", "a.vtk", "a.cgns"])
def test_only_a_grid_of_the_same_blocks_is_an_earlier_one(tmp_path, name):
    grid, other = (Grid.from_blocks([np.random.default_rng(0).random((*shape, 3))]) for shape in ((3, 4, 2), (4, 3, 2)))
    require_earlier_grid(tmp_path / name, grid)
    write_grid(grid, tmp_path / name)
    require_earlier_grid(tmp_path / name, grid)
    for spoil in (lambda: write_grid(other, tmp_path / name), lambda: (tmp_path / name).write_text("mine")):
        spoil()
        with pytest.raises(FormatError, match=rf"{name} exists and is not a grid of an earlier run; it would be repl"):
            require_earlier_grid(tmp_path / name, grid)


def test_thin_grids_are_no_lines(tmp_path):
    """A plate of 1e-9 of its length, far from the origin."""
    points = np.random.default_rng(0).random((3, 4, 2, 3)) * [1.0, 1e-9, 0] + [0, 1e-3, 7.0]
    write_grid(Grid.from_blocks([points]), tmp_path / "a.cgns")
    np.testing.assert_array_equal(read_grid(tmp_path / "a.cgns").block(0), points)


FOREIGN = {
    b"$MeshFormat\n": "a Gmsh mesh (unstructured)", b"NDIME= 2\n": "an SU2 mesh (unstructured)",
    b"#!TDV112": "a Tecplot binary file", b"CDF\x01": "a netCDF file", b"CDF\x02": "a netCDF file",
    b"solid a\n": "an STL surface", b"ISO-10303-21;": "a STEP geometry", b"\x93NUMPY\x01": "a numpy array",
    b"\x89PNG\r\n\x1a\n": "a PNG picture", b"%PDF-1.4": "a PDF document",
    b"PK\x03\x04": "a zip or npz archive; unpack it first", b"\x1f\x8b": "a gzip archive; unpack it first",
    b"BZh9": "a bzip2 archive; unpack it first",
}  # fmt: skip


@pytest.mark.parametrize("begin", FOREIGN)
def test_files_of_other_programs_are_named(tmp_path, begin):
    (tmp_path / "a.xyz").write_bytes(begin + bytes(99))
    with pytest.raises(FormatError) as error:
        read_grid(tmp_path / "a.xyz")
    assert str(error.value).startswith(f"{tmp_path / 'a.xyz'} is {FOREIGN[begin]}, not a block-structured grid (")
