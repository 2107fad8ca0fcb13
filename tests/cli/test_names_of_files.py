"""File names that are not UTF-8, pipes, and files that may not be read or written: said as such, never a traceback."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from grids import frame

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.files import replacing

STRANGE = os.fsdecode(b"gr\xff d")


@pytest.mark.parametrize("suffix", [".xyz", ".fmt", ".cgns", ".vts", ".vtk"])
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


@contextmanager
def at_most(seconds: int) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TimeoutError

    old = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, old)


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "pipe"),
        ("info", "grid.xyz", "--boundary-file", "pipe"),
        ("deform", "grid.xyz", "-c", "pipe", "-o", "z.xyz"),
        ("deform", "grid.xyz", "-d", "pipe", "-o", "z.xyz"),
        ("quality", "grid.xyz", "--reference", "pipe"),
        ("compare", "grid.xyz", "pipe"),
        ("convert", "pipe", "z.xyz"),
        ("plot", "pipe", "-o", "z.png"),
    ],
    ids=" ".join,
)
def test_a_pipe_is_refused_at_once(bench, call, arguments):
    os.mkfifo("pipe")
    with at_most(60):
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


@pytest.mark.parametrize("name", ["a.xyz", "a.cgns", "a.vts", "a.vtk", "a.fmt", "a.vtm"])
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


def test_temporary_files_of_killed_runs_are_removed(tmp_path):
    """Those of running programs, of other machines and of other targets stay."""
    target = tmp_path / "a.xyz"
    with replacing(target) as partial:
        partial.write_text("x")
        name = partial.name
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    gone = name.replace(f".{os.getpid()}-", f".{child}-")
    host = name.split("-")[1][:4]
    other = "0000" if host != "0000" else "1111"
    kept = [name, gone.replace(f"-{host}", f"-{other}"), gone.replace(".a.", ".b."), f".a.{child}.xyz"]
    for left in (gone, *kept):
        (tmp_path / left).write_text("half")
    with replacing(target) as partial:
        partial.write_text("y")
    assert sorted(os.listdir(tmp_path)) == sorted(["a.xyz", *kept])


def test_temporary_files_of_other_users_stay(tmp_path, monkeypatch):
    """Their processes may not even be asked whether they run."""

    def forbidden(*_: int) -> None:
        raise PermissionError(1, "Operation not permitted")

    target = tmp_path / "a.xyz"
    with replacing(target) as partial:
        partial.write_text("x")
        theirs = tmp_path / partial.name.replace(f".{os.getpid()}-", ".1-")
    theirs.write_text("half")
    monkeypatch.setattr(os, "kill", forbidden)
    with replacing(target) as partial:
        partial.write_text("y")
    assert theirs.exists()
