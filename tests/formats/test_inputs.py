"""No file that a run reads is ever replaced, however it is named; links as outputs are followed; room on the disk."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cgns_witness import N, box, tree, write_hdf5, zone
from expected import entries
from grids import frame, frame_2d

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.files import partial_path, remove_partial
from meshdeform_formats.grids import variant_of
from meshdeform_formats.inputs import (
    bytes_at,
    digest,
    existing,
    files_behind,
    lack,
    least_bytes,
    require_no_input,
    size,
    velocity_bytes,
)


@pytest.fixture
def inputs(tmp_path, monkeypatch):
    """A grid as a set, a CGNS file with links into another one, and other names of them."""
    monkeypatch.chdir(tmp_path)
    write_grid(frame(), tmp_path / "set.vtm")
    shutil.copy("set.vtm", "other.vtm")
    (tmp_path / "parts").mkdir()
    write_hdf5(tmp_path / "parts" / "second.cgns", tree(zone("left", box(3, 3, 3))))
    write_hdf5(tmp_path / "linked.cgns", tree(N("left", "", link=("parts/second.cgns", "/Base/left"))))
    write_grid(frame(), tmp_path / "grid.xyz")
    os.link("grid.xyz", "same.xyz")
    os.symlink("grid.xyz", "link.json")
    os.symlink("parts/second.cgns", "short.cgns")
    os.symlink("set/set_1.vts", "picture.png")
    return tmp_path


@pytest.mark.parametrize(("pair", "_", "message"), entries("bad_outputs.txt"))
def test_no_input_is_replaced(inputs, pair, _, message):
    source, output = pair.split(" -> ")
    with pytest.raises(FormatError) as error:
        require_no_input(Path(output), [None, Path("gone.xyz"), Path(source)])
    assert str(error.value) == message


@pytest.mark.parametrize("output", ["new.xyz", "set.xyz", "parts/third.cgns", "third.vtm"])
def test_what_is_no_input_is_replaced(inputs, output):
    Path(output).write_bytes(b"")
    require_no_input(Path(output), [None, *map(Path, ("grid.xyz", "set.vtm", "linked.cgns", "gone.xyz"))])


def test_files_behind_an_input_are_followed(inputs):
    assert files_behind(Path("linked.cgns")) == (Path("linked.cgns"), inputs / "parts/second.cgns")
    assert files_behind(Path("set.vtm")) == tuple(map(Path, ("set.vtm", *(f"set/set_{n}.vts" for n in range(8)))))
    assert files_behind(Path("grid.xyz")) == (Path("grid.xyz"),)
    assert files_behind(Path("gone.xyz")) == (Path("gone.xyz"),)
    assert (size(Path("grid.xyz")), bytes_at(Path("gone.xyz"))) == (Path("grid.xyz").stat().st_size, 0)
    assert digest(Path("link.json")) == digest(Path("same.xyz")) != digest(Path("linked.cgns"))
    pieces = list(Path("set").iterdir())
    assert bytes_at(Path("set.vtm")) == sum(path.stat().st_size for path in [Path("set.vtm"), *pieces])


@pytest.mark.parametrize("name", ["a.xyz", "a.vts", "a.cgns", "a.vtu"])
def test_a_link_as_an_output_is_followed(inputs, name):
    os.mkdir("store")
    target = Path("store") / f"real{Path(name).suffix}"
    os.symlink(target, name)
    grid = read_grid("parts/second.cgns")
    for _ in range(2):
        write_grid(grid, Path(name))
        assert Path(name).is_symlink()
        assert target.is_file()
    assert not target.is_symlink()
    if name != "a.vtu":
        np.testing.assert_array_equal(read_grid(name).points, grid.points)
    assert not list(Path().rglob(".*"))


def test_remains_of_other_files_stay(tmp_path):
    """Where those of one file are removed; the process 4194304 is larger than any."""
    made = [str(partial_path(tmp_path / name)) for name in ("a.xyz", "b.xyz")]
    remains = [path.replace(f".{os.getpid()}-", ".4194305-") for path in made]
    for path in map(Path, remains):
        path.write_bytes(b"")
    remove_partial(tmp_path, tmp_path / "a.xyz")
    assert list(tmp_path.iterdir()) == [Path(remains[1])]
    remove_partial(tmp_path)
    assert list(tmp_path.iterdir()) == []


NODES, PLANE, BLOCK = 1152, 392, 100
VARIANTS = {
    "c.p3dbin": ({"encoding": "binary"}, 24 * NODES),
    "text.p3dfmt": ({}, 0),
    "plane.p2dbin": ({}, 16 * PLANE),
    "new.cgns": ({}, 24 * NODES),
    "single.cgns": ({"precision": "float32"}, 12 * NODES),
    "plane.cgns": ({}, 16 * PLANE),
    "grid.vts": ({}, 24 * BLOCK),
    "text.vts": ({"encoding": "ascii"}, 0),
    "plane.vtk": ({}, 24 * 36),
    "blocks.vtm": ({}, 24 * NODES),
    "mesh.vtu": ({}, 0),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_no_file_is_smaller_than_foretold(name, tmp_path):
    grid = frame_2d() if name.startswith("plane") else frame()
    if name.endswith((".vts", ".vtk")):
        grid = Grid.from_blocks([grid.block(0)])
    path, (options, expected) = tmp_path / name, VARIANTS[name]
    assert least_bytes(grid, path, variant_of(grid, path, options)) == expected
    write_grid(grid, path, options)
    assert expected <= bytes_at(path)
    if name == "new.cgns":
        # A copy has the size of the original, with coordinates half as large.
        for precision, part in (("float64", 1), ("float32", 2)):
            own = read_grid(path)
            variant = variant_of(own, path, {"precision": precision})
            assert least_bytes(own, path, variant) == path.stat().st_size // part


def test_velocities_take_room():
    grid, plane = frame(), frame_2d()
    assert [velocity_bytes(grid, each, "float32") for each in ("none", "first")] == [0, 12 * NODES]
    assert velocity_bytes(grid, "second", "float64") == 24 * NODES
    assert velocity_bytes(grid, "swept", "float32") == 12 * NODES + 48 * grid.n_cells
    assert velocity_bytes(plane, "swept", "float64") == 16 * PLANE + 32 * plane.n_cells


def test_what_the_disk_lacks_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=2048))
    path = tmp_path / "not" / "there" / "out.xyz"
    assert lack(2048, path, "it takes") == ""
    assert lack(4096, path, "it takes") == (
        f"the disk of {tmp_path} has 2 KiB free, it takes at least 4 KiB; free some space, or choose an output on "
        "another disk"
    )
    assert (existing(path.parent), existing(tmp_path)) == (tmp_path, tmp_path)
