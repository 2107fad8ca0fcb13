"""Mistakes of newcomers, each with the first line of the message that it gets."""

from __future__ import annotations

import codecs
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats import write_grid
from meshdeform_samples import generate

DEFORM = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
WITH_TABLE = ("deform", "wing.cgns", "-d", "wrong.csv", "-o", "out.xyz", "--dry-run")


@functools.cache
def wing():
    """The sample grid, and points of its wing's nodes beyond the root, whose frame can be told."""
    grid, _ = generate("wing", 8)
    topology = find_topology(grid)
    nodes = np.unique(topology.quads.corners[select_quads(grid, topology, ["wing"], "wing")])
    points = grid.points[topology.first[nodes]]
    return grid, points[points[:, 1] > 0.2]


def table(change: Callable[[np.ndarray], np.ndarray], motion: Callable[[np.ndarray], np.ndarray] | None = None):
    """Writes ``wing.cgns`` and ``wrong.csv``: the points, changed, and their displacements."""

    def write() -> None:
        grid, points = wing()
        write_grid(grid, Path("wing.cgns"))
        moved = motion(points) if motion else np.full_like(points, 0.01)
        columns = np.hstack([change(points), moved])
        np.savetxt("wrong.csv", columns, "%.17g", delimiter=",", header="x,y,z,dx,dy,dz", comments="")

    return write


def numbered() -> None:
    """Writes ``wrong.csv`` with positions of points and numbers that are not theirs."""
    grid, points = wing()
    write_grid(grid, Path("wing.cgns"))
    np.savetxt("wrong.csv", np.column_stack([7 * np.arange(len(points)), points]), "%.17g")


def edited(name: str, old: str, new: str):
    """Replaces a text of a file."""

    def write() -> None:
        text = Path(name).read_text()
        assert old in text
        Path(name).write_text(text.replace(old, new))

    return write


def own_notes() -> None:
    Path("out.invalid.xyz").write_text("my own notes")


def nothing() -> None:
    """No file is changed."""


# What is done first, the command, and the first line of the message.
MISTAKES = {
    "suffix": (nothing, (*DEFORM[:-1], "out.cgn"), "did you mean '.cgns'?"),
    "hyphen": (nothing, (*DEFORM, "-m", "idwtfi"), "did you mean 'idw-tfi'?"),
    "command": (nothing, ("deforn", "grid.xyz"), "no such command 'deforn'; did you mean 'deform'?"),
    "constant": (
        nothing, (*DEFORM, "-s", "turn=10"), "--set 'turn=10': unknown key 'turn'; did you mean 'constants.turn'?",
    ),
    "another origin": (
        table(lambda p: p + [3, 4, 5]), WITH_TABLE, "(shifted by (-3, -4, -5), 100% of its points would",
    ),
    "numbers of another mesh": (numbered, WITH_TABLE, "95 of 121 table points lie on no face that the table moves"),
    "decimal commas": (
        lambda: Path("wrong.csv").write_text("x;y;z;dx;dy;dz\n0,5;0;0;0;0;0\n"),
        ("deform", "grid.xyz", "-d", "wrong.csv", "-o", "out.xyz"),
        "'0,5' is not a number; decimal commas are not read",
    ),
    "a file with the name of the invalid grid": (
        own_notes, (*DEFORM, "-s", "constants.turn=85", "--repair", "off"), "out.invalid.xyz",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_the_message_names_the_mistake(name, bench, call):
    prepare, arguments, message = MISTAKES[name]
    prepare()
    result = call(*arguments)
    assert result.code == 2
    assert message in result.error.splitlines()[0] + result.error.splitlines()[-1]
    assert not Path("out.invalid.xyz").exists() or Path("out.invalid.xyz").read_text() == "my own notes"


DOUBTS = {
    "positions": (table(lambda p: p, lambda p: p), WITH_TABLE, "are they positions?"),
    "another unit": (
        nothing,
        (*DEFORM, "-s", "boundary=[{motion=[{translate=[1e3, 0, 0]}]}]", "--dry-run"),
        "the size of the grid",
    ),
    "radians": (nothing, (*DEFORM, "-s", "constants.turn=0.17", "--dry-run"), "degrees; angles are in degrees"),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_what_is_doubtful_is_a_warning_before_anything_is_moved(name, bench, call):
    prepare, arguments, message = DOUBTS[name]
    prepare()
    assert any(message in warning for warning in call(*arguments).warnings)


def test_byte_order_marks_of_editors_are_accepted(bench, call):
    for name in ("case.toml", "table.csv", "grid.p3dfmt"):
        Path(name).write_bytes(codecs.BOM_UTF8 + Path(name).read_bytes())
    assert call("deform", "grid.p3dfmt", "-c", "case.toml", "-o", "out.p3dfmt", "-q").code == 0
    assert call("deform", "grid.p3dfmt", "-d", "table.csv", "-o", "moved.p3dfmt", "-q").code == 0
