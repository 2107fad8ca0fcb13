"""Multi-block sets: nested names, whole sets or none, and foreign pieces."""

import itertools
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import vtk_witness
from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet, vtkMultiBlockDataSet
from vtkmodules.vtkIOXML import vtkXMLMultiBlockDataReader, vtkXMLMultiBlockDataWriter

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid


def blocks(*shapes, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(*shape, 3)) for shape in shapes]


def grid_of(*names, seed=0):
    return Grid.from_blocks(blocks(*((2, 3, 2 + n) for n in range(len(names))), seed=seed), names)


def vtk_set(tree):
    """vtkMultiBlockDataSet from ``[(name or None, array, list or None)]``."""
    found = vtkMultiBlockDataSet()
    for index, (name, entry) in enumerate(tree):
        child = vtk_set(entry) if isinstance(entry, list) else entry
        found.SetBlock(index, vtk_witness.structured_grid(child) if isinstance(child, np.ndarray) else child)
        if name:
            found.GetMetaData(index).Set(vtkCompositeDataSet.NAME(), name)
    return found


def tree_of(data_set):
    """Names and number of points of a set as VTK reads it."""
    found = []
    for index in range(data_set.GetNumberOfBlocks()):
        block = data_set.GetBlock(index)
        name = data_set.GetMetaData(index).Get(vtkCompositeDataSet.NAME())
        inner = tree_of(block) if block.IsA("vtkMultiBlockDataSet") else block.GetNumberOfPoints()
        found.append((name, inner))
    return found


def test_nested_sets_of_vtk(tmp_path, monkeypatch):
    a, b, c, d = blocks((2, 3, 4), (3, 3, 3), (2, 2, 2), (4, 2, 2))
    (tmp_path / "sub").mkdir()
    a = a.astype(np.float32)
    tree = [("fluid", [("wing", a), ("tail", b), ("wing", a)]), (None, None), (None, c), ("wing", [(None, d)])]
    tree.append((None, [("tip", b)]))
    writer = vtkXMLMultiBlockDataWriter()
    writer.SetInputData(vtk_set(tree))
    writer.SetFileName(str(tmp_path / "sub" / "set.vtm"))
    assert writer.Write()
    monkeypatch.chdir(tmp_path)
    grid = read_grid(Path("sub") / "set.vtm")
    assert grid.names == ("fluid/wing", "fluid/tail", "fluid/wing_3", "block4", "wing/block5", "tip")
    for index, points in enumerate((a, b, a, c, d, b)):
        np.testing.assert_array_equal(grid.block(index), points)
    assert (grid.format.options["kind"], grid.precision) == ("vtm", "float64")


def test_vtk_reads_our_set(tmp_path):
    grid = grid_of("fluid/wing <1>", "fluid/tail", "solid")
    write_grid(grid, tmp_path / "set.vtm")
    reader = vtkXMLMultiBlockDataReader()
    reader.SetFileName(str(tmp_path / "set.vtm"))
    reader.Update()
    assert tree_of(reader.GetOutput()) == [("fluid", [("wing <1>", 12), ("tail", 18)]), ("solid", 24)]
    again = read_grid(tmp_path / "set.vtm")
    assert again.names == grid.names
    np.testing.assert_array_equal(again.points, grid.points)


def content(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_new_set_replaces_the_old_one_as_a_whole(tmp_path):
    write_grid(grid_of("a", "b", "c"), tmp_path / "set.vtm")
    write_grid(grid_of("x", "y", seed=1), tmp_path / "set.vtm")
    assert set(content(tmp_path)) == {"set.vtm", "set/set_0.1.vts", "set/set_1.1.vts"}
    assert read_grid(tmp_path / "set.vtm").names == ("x", "y")
    write_grid(grid_of("a", "b", "c"), tmp_path / "set.vtm")
    assert set(content(tmp_path)) == {"set.vtm", "set/set_0.vts", "set/set_1.vts", "set/set_2.vts"}


OPERATIONS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.listdir")


def killed_at(folder, number, write):
    """Exit code of a process that is killed at its ``number``-th access to the folder; 0 if it writes to the end."""
    child = os.fork()
    if child == 0:
        accesses = itertools.count(1)

        def hook(event, args):
            if event in OPERATIONS and str(args[0]).startswith(str(folder)) and next(accesses) == number:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        try:
            write()
        except BaseException:
            os._exit(3)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize(("suffix", "count"), [(".vtm", 5), (".cgns", 1)])
def test_a_grid_is_replaced_as_a_whole_or_not_at_all(suffix, count, tmp_path):
    """A kill at any access to the disk leaves the old or the new grid; the next run finds nothing else."""
    target, new = tmp_path / f"set{suffix}", grid_of("x", "y", seed=1)
    for number in itertools.count(1):
        for path in tmp_path.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        old = grid_of("a", "b")
        write_grid(old, target)
        done = killed_at(tmp_path, number, lambda: write_grid(new, target))
        found = read_grid(target)
        assert found.names in (old.names, new.names)
        np.testing.assert_array_equal(found.points, (new if found.names == new.names else old).points)
        if done == 0:
            break
        assert done == -signal.SIGKILL
        write_grid(grid_of("p", "q", "r", "s", seed=2), target)
        assert len(content(tmp_path)) == count
        assert read_grid(target).names == ("p", "q", "r", "s")
    assert number > (10 if count > 1 else 1)
    assert len(content(tmp_path)) == min(count, 3)


def test_a_journal_is_no_licence(tmp_path):
    """What a journal lists is removed only from the folder itself, and never a piece of the present set."""
    (tmp_path / "mine.vts").write_text("mine")
    write_grid(grid_of("a", "b"), tmp_path / "set.vtm")
    journal = tmp_path / "set" / ".meshdeform-unfinished"
    journal.write_text("../mine.vts\nset_0.vts\nset_7.vts\n/etc/passwd\n")
    (tmp_path / "set" / "set_7.vts").write_text("half")
    write_grid(grid_of("x", seed=1), tmp_path / "set.vtm")
    assert set(content(tmp_path)) == {"mine.vts", "set.vtm", "set/set_0.1.vts"}


def test_a_folder_that_is_not_ours_is_left_alone(tmp_path):
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "notes.txt").write_text("mine")
    with pytest.raises(
        FormatError, match=r"pieces go to the folder .*case, which contains notes\.txt and is not replaced"
    ):
        write_grid(grid_of("a"), tmp_path / "case.vtm")
    assert content(tmp_path) == {"case/notes.txt": b"mine"}
    write_grid(grid_of("a"), tmp_path / "set.vtm")
    (tmp_path / "set" / "mine.vts").write_text("mine")
    with pytest.raises(FormatError, match=r"contains mine\.vts"):
        write_grid(grid_of("a"), tmp_path / "set.vtm")
    (tmp_path / "other").write_text("mine")
    with pytest.raises(FormatError, match="but that is a file"):
        write_grid(grid_of("a"), tmp_path / "other.vtm")


def index(body):
    return f'<VTKFile type="vtkMultiBlockDataSet" byte_order="LittleEndian">{body}</VTKFile>'


def in_set(*files):
    tags = "".join(f'<DataSet index="{n}" file="{file}"/>' for n, file in enumerate(files))
    return index(f"<vtkMultiBlockDataSet>{tags}</vtkMultiBlockDataSet>")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (index(""), "has no vtkMultiBlockDataSet element"),
        (index("<vtkMultiBlockDataSet/>"), "refers to no data sets"),
        (index('<vtkMultiBlockDataSet/><DataSet file="one.vts"/>'), "1 DataSet elements lie outside of vtkMultiBlock"),
        (index("<vtkMultiBlockDataSet>"), r"set\.vtm: Error parsing XML: mismatched tag"),
        (in_set("missing.vts"), r"refers to .*missing\.vts, which does not exist"),
        (in_set("empty.vts"), r"empty\.vts is empty"),
        (in_set("set.vtm"), r"set\.vtm is a multi-block set"),
        (in_set("surface.vtp"), r"surface\.vtp is a polygon surface"),
        (in_set("one.vts", "cut.vts"), r"cut\.vts does not end with </VTKFile>"),
        (in_set("one.vts", "plane.vts"), r"set\.vtm: the grid mixes 2-D and 3-D blocks"),
    ],
)
def test_wrong_sets(tmp_path, text, message):
    write_grid(grid_of("a"), tmp_path / "one.vts")
    write_grid(Grid.from_blocks(blocks((2, 2, 1))), tmp_path / "plane.vts")
    (tmp_path / "cut.vts").write_bytes((tmp_path / "one.vts").read_bytes()[:-30])
    (tmp_path / "empty.vts").touch()
    (tmp_path / "surface.vtp").write_text('<VTKFile type="PolyData" byte_order="LittleEndian"></VTKFile>')
    (tmp_path / "set.vtm").write_text(text)
    with pytest.raises((FormatError, GridError), match=message):
        read_grid(tmp_path / "set.vtm")
