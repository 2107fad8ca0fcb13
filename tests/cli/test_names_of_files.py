"""File names that are not UTF-8, pipes, and files that may not be read or written: said as such, never a traceback."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from grids import frame

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid

STRANGE = os.fsdecode(b"gr\xff d")


@pytest.mark.parametrize("suffix", [".xyz", ".cgns", ".vts"])
def test_names_that_are_not_utf8(bench, call, suffix):
    grid = Grid.from_blocks([frame().block(0)])
    write_grid(grid, STRANGE + suffix)
    done = call("convert", STRANGE + suffix, f"again{STRANGE}{suffix}", "-q")
    assert (done.code, done.err) == (0, "")
    np.testing.assert_array_equal(read_grid(f"again{STRANGE}{suffix}").points, grid.points)


def test_a_set_has_a_name_in_utf8(bench, call, snapshot):
    before = snapshot(bench)
    result = call("convert", "grid.xyz", f"{STRANGE}.vtm")
    assert result.code == 2
    assert "its name is not UTF-8" in result.err
    assert snapshot(bench) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "pipe"),
        ("info", "grid.xyz", "--boundary-file", "pipe"),
        ("deform", "grid.xyz", "-c", "pipe", "-o", "z.xyz"),
        ("deform", "grid.xyz", "-d", "pipe", "-o", "z.xyz"),
        ("quality", "grid.xyz", "--reference", "pipe"),
    ],
    ids=" ".join,
)
def test_a_pipe_is_refused_at_once(bench, call, arguments):
    os.mkfifo("pipe")
    result = call(*arguments)
    assert result.code == 2
    assert "pipe: it is a pipe; expected a file" in result.err


@contextmanager
def as_nobody() -> Iterator[None]:
    """The rights of a user to whom nothing here belongs."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.parametrize("name", ["a.xyz", "a.cgns", "a.vtm"])
def test_no_permission_is_said(tmp_path, name):
    for path in (tmp_path, *tmp_path.parents):
        if path.name.startswith(("pytest-of-", "pytest-", "popen-", "test_")):
            path.chmod(0o755)
    grid = Grid.from_blocks([frame().block(0)])
    write_grid(grid, tmp_path / name)
    (tmp_path / "closed").mkdir(mode=0o755)
    (tmp_path / name).chmod(0)
    (tmp_path / "closed").chmod(0o555)
    with as_nobody():
        if os.access(tmp_path / name, os.R_OK, effective_ids=True):
            pytest.skip("this user may read everything")
        with pytest.raises(FormatError, match=f"cannot read .*{name}: Permission denied$"):
            read_grid(tmp_path / name)
        with pytest.raises(FormatError, match=f"cannot write .*{name}: Permission denied$"):
            write_grid(grid, tmp_path / "closed" / name)
    assert not list((tmp_path / "closed").iterdir())
