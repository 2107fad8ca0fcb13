"""Grids of many blocks, and the processor time of every command on the same nodes in 10 to 10,000 blocks."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from runs import run
from tables import MarkdownTable, Row, exponent

from meshdeform_core.grid import Connection, FloatArray, Grid, Patch, Side, Window
from meshdeform_core.grid.parts import FileFormat
from meshdeform_formats.grids import write_grid

_FAMILIES = dict(zip(Side, ("inflow", "outflow", "wall", "far", "left", "right"), strict=True))
CASE = """[[boundary]]
name = "wall"
select = ["*.jmin"]
kind = "moving"
motion = [{ displace = ["0.01*sin(5*y)", "0.03*sin(3*x)*cos(2*z)", "0.0"] }]

[[boundary]]
name = "sides"
select = ["*.kmin", "*.kmax"]
kind = "slip"

[[boundary]]
name = "outer"
select = ["*.i*", "*.jmax"]
kind = "fixed"
"""
"""The wall moves, whatever the format keeps of patches."""


def box(blocks: tuple[int, int, int], nodes: tuple[int, int, int], ring: bool = False) -> Grid:
    """A box cut into blocks of the same number of nodes; every outside face of a block is a patch of a family.

    Parameters
    ----------
    ring : bent into a ring around a wall, closed along i: an O-grid with a seam, cells that grow off the wall
    """
    at = [positions(count, n) for count, n in zip(blocks, nodes, strict=True)]
    grids, patches, connections = [], [], []
    for number, place in enumerate(np.ndindex(*blocks)):
        u, v, w = np.meshgrid(*(along[start] for along, start in zip(at, place, strict=True)), indexing="ij")
        grids.append(_ring(u, v, w) if ring else bent(u, v, w))
        patches += _patches(number, place, blocks, nodes, closed=ring)
        connections += _connections(number, place, blocks, nodes, closed=ring)
    names = [f"zone{number + 1}" for number in range(len(grids))]
    declared = {"patches": tuple(patches), "connections": tuple(connections)}
    return Grid.from_blocks(grids, names, **declared, format=FileFormat("cgns"))


def positions(count: int, n: int) -> FloatArray:
    """Parameters (count, n) of the nodes of every block along one direction; blocks share their ends exactly."""
    step = np.arange(count * (n - 1) + 1) / (count * (n - 1))
    return step[np.arange(count)[:, None] * (n - 1) + np.arange(n)]


def bent(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """A box whose lines are slightly curved."""
    wave = 0.02 * np.sin(2 * np.pi * u) * np.sin(2 * np.pi * v)
    return np.stack([u + wave, v + wave * np.cos(w), w + 0 * u], axis=-1)


def _ring(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    radius = 0.5 + 2.0 * np.expm1(2.5 * v) / np.expm1(2.5)
    angle = 2 * np.pi * (u % 1.0)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), w * (1 + 0.1 * np.sin(angle))], axis=-1)


def _patches(
    number: int, place: tuple[int, ...], blocks: tuple[int, int, int], nodes: tuple[int, int, int], closed: bool
) -> list[Patch]:
    found = []
    for side, family in _FAMILIES.items():
        if closed and side.axis == 0:
            continue
        if place[side.axis] == (blocks[side.axis] - 1 if side % 2 else 0):
            a, b = side.tangential
            window = Window(number, side, (0, 0), (nodes[a] - 1, nodes[b] - 1))
            kind = "BCWallViscous" if family == "wall" else "BCFarfield"
            found.append(Patch(f"{family}{number + 1}", (window,), family, kind))
    return found


def _connections(
    number: int, place: tuple[int, ...], blocks: tuple[int, int, int], nodes: tuple[int, int, int], closed: bool
) -> list[Connection]:
    """The interfaces with the next block along i, j and k."""
    found = []
    for axis in range(3):
        following = list(place)
        following[axis] += 1
        if following[axis] == blocks[axis]:
            if not (closed and axis == 0):
                continue
            following[axis] = 0
        begin, donor_end = [0, 0, 0], [n - 1 for n in nodes]
        begin[axis], donor_end[axis] = nodes[axis] - 1, 0
        donor = int(np.ravel_multi_index(following, blocks))
        found.append(
            Connection(
                f"to{donor + 1}along{'ijk'[axis]}",
                number,
                tuple(begin),
                tuple(n - 1 for n in nodes),
                donor,
                (0, 0, 0),
                tuple(donor_end),
                (1, 2, 3),
            )
        )
    return found


SIZES = {
    10: ((5, 2, 1), 51), 100: ((5, 5, 4), 24), 1000: ((10, 10, 10), 11), 10_000: ((25, 20, 20), 5),
}  # fmt: skip
"""Blocks along i, j, k and nodes along each index of a block: about 1.3 million nodes in 10 to 10,000 blocks."""
_STAGES = ("read", "topology", "prepare", "apply", "quality", "write")


def make(folder: Path, count: int, suffix: str, ring: bool = False, nodes: int | None = None) -> Path:
    """Grid and case in a folder."""
    blocks, size = SIZES[count]
    write_grid(box(blocks, (nodes or size,) * 3, ring), folder / f"grid{suffix}")
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    return folder


def by_blocks(quick: bool, suffix: str = ".p3dbin") -> MarkdownTable:
    """``deform`` with reports in JSON and HTML, and ``info --json``, of the same nodes in more and more blocks."""
    table = MarkdownTable(
        "The same nodes in 10 to 10,000 blocks",
        notes=[
            f"{suffix} files; seconds of processor time with one thread, start of Python included; `deform` writes a "
            "report as JSON and as a page; the stages are those of its report by default, with nothing to repair "
            "(wall time)",
            "exponent: p of seconds = c blocks^p, by least squares",
        ],
    )
    rows = []
    for count in (10, 100) if quick else SIZES:
        with tempfile.TemporaryDirectory() as name:
            rows.append({"blocks": count, **_measured(make(Path(name), count, suffix), suffix)})
    table.rows += rows
    counts = [row["blocks"] for row in rows]
    powers = {key: exponent(counts, [max(row[key], 1e-3) for row in rows]) for key in list(rows[0])[2:]}
    table.rows.append({"blocks": "exponent", "nodes": "", **powers})
    return table


def _measured(folder: Path, suffix: str) -> Row:
    grid, report = str(folder / f"grid{suffix}"), folder / "report.json"
    command = [sys.executable, "-m", "meshdeform"]
    job = [
        *command, "deform", grid, "-c", f"{folder}/case.toml", "-o", f"{folder}/out{suffix}", "--report", str(report),
        "--report", f"{folder}/report.html", "-q", "--force", "--threads", "1",
    ]  # fmt: skip
    usages = [run(each)[1] for each in ([*command, "info", grid, "--json"], [*job, "--repair", "off"], job)]
    info, off, deform = (usage.ru_utime + usage.ru_stime for usage in usages)
    facts = json.loads(report.read_text(encoding="utf-8"))
    stages = {stage: facts["timing"].get(stage, 0.0) for stage in _STAGES}
    return {"nodes": facts["grid"]["nodes"], "info s": info, "repair off s": off, "deform s": deform, **stages}


_OTHERS = {
    "quality s": ("quality", "{grid}", "--json"),
    "compare s": ("compare", "{grid}", "{grid}", "--json"),
    "init s": ("init", "{grid}", "-o", "{folder}/init.toml", "--force"),
    "plot s": ("plot", "{grid}", "-o", "{folder}/plot.png", "--force"),
    "to .vtm s": ("convert", "{grid}", "{folder}/out.vtm", "--force"),
    "to .cgns s": ("convert", "{grid}", "{folder}/out.cgns", "--force"),
    "from .cgns s": ("convert", "{folder}/out.cgns", "{folder}/out.p3dbin", "--force"),
}


def other_commands(quick: bool) -> MarkdownTable:
    """Every other command that reads a grid, on the same nodes in more and more blocks."""
    table = MarkdownTable(
        "Other commands, the same nodes in 10 to 10,000 blocks",
        notes=["Plot3D files; seconds of processor time with one thread, start of Python included"],
    )
    for count in (10, 100) if quick else SIZES:
        with tempfile.TemporaryDirectory() as folder:
            grid = make(Path(folder), count, ".p3dbin") / "grid.p3dbin"
            row: Row = {"blocks": count}
            for name, words in _OTHERS.items():
                command = [word.format(grid=grid, folder=folder) for word in words]
                usage = run([sys.executable, "-m", "meshdeform", *command])[1]
                row[name] = usage.ru_utime + usage.ru_stime
            table.rows.append(row)
    return table


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="10 and 100 blocks only")
    parser.add_argument("--only-deform", action="store_true", help="without the table of the other commands")
    parser.add_argument("--suffix", default=".p3dbin", help="format of the grids (%(default)s)")
    parser.add_argument("--make", type=Path, metavar="FOLDER", help="only write a grid and its case there")
    parser.add_argument("--blocks", type=int, choices=SIZES, default=1000, help="for --make (%(default)s)")
    parser.add_argument("--nodes", type=int, help="for --make: nodes along each index of a block")
    parser.add_argument("--ring", action="store_true", help="for --make: an O-grid instead of a box")
    options = parser.parse_args()
    if options.make:
        options.make.mkdir(parents=True, exist_ok=True)
        make(options.make, options.blocks, options.suffix, options.ring, options.nodes)
    else:
        print(by_blocks(options.quick, options.suffix).markdown())
        if not options.only_deform:
            print(other_commands(options.quick).markdown())


if __name__ == "__main__":
    main()
