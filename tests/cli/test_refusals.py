"""Wrong calls, wrong case files and mistakes of newcomers: one message each that names what is wrong, nothing written;
what is doubtful is a warning."""

import codecs
import functools
import os
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from expected import check_message, entries

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


def own_notes() -> None:
    Path("out.invalid.xyz").write_text("my own notes")


def linked() -> None:
    for name in ("link.json", "link.png"):
        os.symlink("grid.xyz", name)


# id: (what is done first, arguments, a fragment of the message)
MISTAKES = {
    "another origin": (
        table(lambda p: p + [3, 4, 5]), WITH_TABLE, "(shifted by (-3, -4, -5), 100% of its points would",
    ),
    "numbers of another mesh": (numbered, WITH_TABLE, "95 of 121 table points lie on no face that the table moves"),
    "a report that is the grid": (linked, ("quality", "grid.xyz", "--report", "link.json", "--force"), "is an input"),
    "a picture that is the grid": (linked, ("plot", "grid.xyz", "-o", "link.png", "--force"), "is an input"),
    "an option that is none": (None, (*DEFORM, "--stepz", "3"), "No such option"),
    "a file with the name of the invalid grid": (
        own_notes, (*DEFORM, "-s", "constants.turn=85", "--repair", "off"), "out.invalid.xyz",
    ),
}  # fmt: skip


REFUSED = [
    pytest.param(shlex.join(arguments), prepare, f"...{fragment}...", id=name)
    for name, (prepare, arguments, fragment) in MISTAKES.items()
]


@pytest.mark.parametrize(("arguments", "prepare", "message"), [*REFUSED, *entries("bad_calls.txt")])
def test_it_is_refused_with_one_message_and_nothing_is_written(arguments, prepare, message, bench, call, snapshot):
    (bench / "folder.xyz").mkdir()
    os.mkfifo("pipe")
    if callable(prepare):
        prepare()
    elif prepare:
        Path("wrong.toml").write_text(prepare)
    before = snapshot(bench)
    result = call(*shlex.split(arguments))
    assert snapshot(bench) == before
    assert (result.code, result.out, result.error.count("\n")) == (2, "", 1), result.err
    check_message(result.error, f"meshdeform: error: {message}\n", bench)


DOUBTS = {
    "positions": (table(lambda p: p, lambda p: p), WITH_TABLE, "are they positions?"),
    "radians": (None, (*DEFORM, "-s", "constants.turn=0.17", "--dry-run"), "degrees; angles are in degrees"),
    "turns": (None, (*DEFORM, "-s", "constants.turn=-4e3", "--dry-run"), "by -4000 degrees; its nodes come to where a"),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_what_is_doubtful_is_a_warning_before_anything_is_moved(name, bench, call):
    prepare, arguments, message = DOUBTS[name]
    if prepare:
        prepare()
    assert any(message in warning for warning in call(*arguments).warnings)


def test_byte_order_marks_of_editors_are_accepted(bench, call):
    for name in ("case.toml", "table.csv", "grid.p3dfmt"):
        Path(name).write_bytes(codecs.BOM_UTF8 + Path(name).read_bytes())
    assert call("deform", "grid.p3dfmt", "-c", "case.toml", "-o", "out.p3dfmt", "-q").code == 0
    assert call("deform", "grid.p3dfmt", "-d", "table.csv", "-o", "moved.p3dfmt", "-q").code == 0
