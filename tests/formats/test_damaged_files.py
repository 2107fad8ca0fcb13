"""Damage of every readable format: a file is read or refused with a message, never anything else."""

import os
import random
import stat
import time
import warnings
import zipfile

import h5py
import numpy as np
import pytest
from cgns_witness import AdfWriter, two_zones, write_hdf5
from fuzz.mutations import mutated

from meshdeform_core.errors import FormatError, GridError, MeshDeformError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.displacement import read_displacement

POINTS = np.random.default_rng(0).random((10, 3))


def grid_file(name, **options):
    rng = np.random.default_rng(1)
    grid = Grid.from_blocks([rng.random((3, 3, 2, 3))], fields=(Field("p", "node", 0, rng.random((3, 3, 2))),))

    def make(folder):
        write_grid(grid, folder / name, options)
        return folder / name

    return make


def saved(save, name, *args, **arrays):
    def make(folder):
        save(folder / name, *args, **arrays)
        return folder / name

    return make


def hdf5_table(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        file["points"] = file["displacement"] = POINTS
    return folder / "a.h5"


SOURCES = {
    "cgns": (read_grid, lambda folder: write_hdf5(folder / "a.cgns", two_zones())),
    "adf": (read_grid, lambda folder: AdfWriter().write(folder / "a.adf", two_zones())),
    "vts": (read_grid, grid_file("a.vts")),
    "vts-zlib": (read_grid, grid_file("a.vts", compression="zlib")),
    "vts-ascii": (read_grid, grid_file("a.vts", encoding="ascii")),
    "vtm": (read_grid, grid_file("a.vtm")),
    "vtk": (read_grid, grid_file("a.vtk")),
    "vtk-ascii": (read_grid, grid_file("a.vtk", encoding="ascii")),
    "plot3d": (read_grid, grid_file("a.xyz")),
    "plot3d-ascii": (read_grid, grid_file("a.fmt")),
    "npy": (read_displacement, saved(np.save, "a.npy", np.hstack([POINTS, POINTS]))),
    "npz": (read_displacement, saved(np.savez, "a.npz", points=POINTS, displacement=POINTS)),
    "npz-packed": (read_displacement, saved(np.savez_compressed, "a.npz", points=POINTS, displacement=POINTS)),
    "h5": (read_displacement, hdf5_table),
    "csv": (read_displacement, saved(np.savetxt, "a.csv", np.hstack([POINTS, POINTS]), delimiter=",")),
}


@pytest.mark.parametrize("name", SOURCES)
def test_damaged_files_are_read_or_refused(tmp_path, capfd, name):
    read, make = SOURCES[name]
    source = make(tmp_path)
    read(source)
    data, rng, target = source.read_bytes(), random.Random(7), tmp_path / f"b{source.suffix}"
    refused = 0
    for _ in range(60):
        target.write_bytes(mutated(data, True, rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read(target)
        except MeshDeformError as error:
            refused += 1
            assert target.name in str(error)  # noqa: PT017
    assert refused > 10
    assert capfd.readouterr() == ("", "")


def zipped(path, **members):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name.replace("_", "."), data)


def npy(values, folder):
    np.save(folder / "one.npy", values)
    return (folder / "one.npy").read_bytes()


def test_archives_that_are_no_tables(tmp_path):
    good, path = npy(POINTS, tmp_path), tmp_path / "a.npz"

    def refuses(message):
        with pytest.raises(FormatError, match=message) as error:
            read_displacement(path)
        assert "a.npz" in str(error.value)

    zipped(path, points_npy=good, notes_txt=b"mine")
    refuses(r"its member 'notes\.txt' is not an array")
    zipped(path, points_npy=b"mine", displacement_npy=good)
    refuses("its member 'points' is not an array")
    zipped(path, points_npy=good[:-8], displacement_npy=good)
    refuses("EOF: reading array data, expected 240 bytes got 232")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with zipfile.ZipFile(path, "w") as archive:
            for name in ("points", "displacement", "points"):
                archive.writestr(f"{name}.npy", good)
    refuses("it has several arrays of the same name: displacement, points, points")
    zipped(path, points_npy=good, displacement_npy=good)
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    refuses(r"'points\.npy' is encrypted, password required")
    huge = good.replace(b"(10, 3), }         ", b"(10**9, 3), }      ")
    zipped(path, points_npy=huge, displacement_npy=good)
    refuses(r"cannot read")
    huge = good.replace(b"(10, 3), }         ", b"(1000000000, 3), } ")
    zipped(path, points_npy=huge, displacement_npy=good)
    refuses("EOF: reading array data|Unable to allocate")
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
        (np.linspace(1e-320, 1e-310, 24), "smaller than any normal number"),
        (np.full(24, 3.0), "all 8 nodes lie at one point"),
        (np.repeat(np.arange(8.0), 3), "all 8 nodes lie on one line"),
    ],
)
def test_coordinates_that_cannot_be_meant(tmp_path, name, values, message):
    points = np.random.default_rng(0).random((2, 2, 2, 3))
    points[1, 0, 0, 0] = values[0]
    if len(values) == 24:
        points = np.asarray(values).reshape(2, 2, 2, 3)
    write_grid(Grid.from_blocks([points]), tmp_path / name)
    with pytest.raises(
        (GridError, FormatError), match=f"{message}|would be implausible" if name == "a.xyz" else message
    ):
        read_grid(tmp_path / name)


def test_thin_grids_are_no_lines(tmp_path):
    """A plate of 1e-9 of its length, far from the origin."""
    points = np.random.default_rng(0).random((3, 4, 2, 3)) * [1.0, 1e-9, 0] + [0, 1e-3, 7.0]
    write_grid(Grid.from_blocks([points]), tmp_path / "a.cgns")
    np.testing.assert_array_equal(read_grid(tmp_path / "a.cgns").block(0), points)


@pytest.mark.parametrize("read", [read_grid, read_displacement])
def test_what_is_no_file(tmp_path, read):
    """A pipe would be waited for, a device read for ever."""
    os.mkfifo(tmp_path / "a.csv")
    (tmp_path / "b.csv").symlink_to("/dev/zero")
    (tmp_path / "c.csv").symlink_to("nowhere")
    start = time.process_time()
    for name, message in (("a", "it is a pipe"), ("b", "it is a device"), ("c", "No such file|is a broken link")):
        with pytest.raises(FormatError, match=message):
            read(tmp_path / f"{name}.csv")
    assert time.process_time() - start < 5
    assert stat.S_ISFIFO((tmp_path / "a.csv").stat().st_mode)


@pytest.mark.parametrize("row", ["1,2,,4,5,6", "1,2,3,4,5,", "1,2,3,4,5", "1,2,3,4,5,6,7", "1,2,x,4,5,6", ",,,,,"])
@pytest.mark.parametrize("line", [1, 2, 3])
@pytest.mark.parametrize("header", [True, False])
def test_a_row_with_a_missing_value(tmp_path, row, line, header):
    rows = ["0,0,0,1,1,1", "1,0,0,1,1,1", "2,0,0,1,1,1"]
    rows[line - 1] = row
    (tmp_path / "a.csv").write_text("\n".join(["x,y,z,dx,dy,dz"] * header + rows) + "\n")
    with pytest.raises(FormatError, match=r"a\.csv") as error:
        read_displacement(tmp_path / "a.csv")
    bad = line + header
    # The first row says how many columns there are.
    accepted = (bad, bad + 1) if row.count(",") != 5 else (bad,)
    assert any(f"line {number}:" in str(error.value) for number in accepted) or "expected a name for each" in str(
        error.value
    )
