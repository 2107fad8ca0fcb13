"""Inputs that once gave a wrong result, a traceback or an abort, made anew: one function per kind of defect.

Each writes its files into the current folder. The names are those of the table in the issue where the defects were
collected; a grid with a curved wall (``g3``) and two blocks side by side (``e4``) serve as their good part.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from cgns_witness import N, two_zones, write_hdf5

from meshdeform_core.grid import Grid
from meshdeform_formats import write_grid

NESTED = 5000


def curved(blocks: int = 2) -> Grid:
    """Blocks of 5 x 4 x 3 nodes one behind the other over a bump, spanned from z = 0 to 0.7."""
    x = np.linspace(0.0, blocks, 4 * blocks + 1)
    y, z = np.array([0.0, 0.24, 0.59, 1.0]), np.array([0.0, 0.35, 0.7])
    box = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    box[..., 1] += 0.05 * np.sin(np.pi * box[..., 0]) * (1.0 - box[..., 1])
    return Grid.from_blocks([np.ascontiguousarray(box[4 * n : 4 * n + 5]) for n in range(blocks)])


def c_const() -> None:
    """All nodes at one point."""
    write_grid(Grid.from_blocks([np.ones((3, 3, 3, 3))]), "c_const.xyz")


def c_deep() -> None:
    """Blocks inside blocks inside blocks."""
    inner = "<Block>" * NESTED + "</Block>" * NESTED
    Path("c_deep.vtm").write_text(
        f'<VTKFile type="vtkMultiBlockDataSet"><vtkMultiBlockDataSet>{inner}</vtkMultiBlockDataSet></VTKFile>'
    )


def c_root() -> None:
    """A bit of the root group of an HDF5 file has changed; its checksum is wrong."""
    write_hdf5(Path("c_root.cgns"), two_zones())
    data = bytearray(Path("c_root.cgns").read_bytes())
    with h5py.File("c_root.cgns") as file:
        at = h5py.h5o.get_info(file.id).addr
    if data[at : at + 4] != b"OHDR":
        # Old object headers have no checksum; their first byte is the version.
        data[at] = 77
    data[at + 12] ^= 0xFF
    Path("c_root.cgns").write_bytes(data)


def d1_abort() -> None:
    """The tag of the appended data stands there twice."""
    write_grid(curved(1), "d1_abort.vts")
    data = Path("d1_abort.vts").read_bytes()
    tag = re.search(rb'[ \t]*<AppendedData encoding="raw">\n?', data)
    assert tag
    Path("d1_abort.vts").write_bytes(data[: tag.end()] + tag[0] + data[tag.end() :])


def d2_abort() -> None:
    """An array declares 2**31 - 1 components."""
    _ascii("d2_abort.vts", b'NumberOfComponents="3"', b'NumberOfComponents="2147483647"')


def e1_partial() -> None:
    """The only Piece covers a part of the extent."""
    write_grid(Grid.from_blocks([curved(1).block(0)[:3]]), "e1_partial.vts", {"encoding": "ascii"})
    text = Path("e1_partial.vts").read_text()
    Path("e1_partial.vts").write_text(text.replace('WholeExtent="0 2', 'WholeExtent="0 4'))


def e2_zone() -> None:
    """A zone is a link to a file that is not there."""
    root = two_zones()
    base = root["Base"]
    base.children = [
        N(node.name, "", link=("part2.cgns", f"/Base/{node.name}")) if node.name == "right" else node
        for node in base.children
    ]
    write_hdf5(Path("e2_zone_link_missing.cgns"), root)


def e2b_zonebc() -> None:
    """The boundary conditions of a zone are a link to a file that is not there."""
    root = two_zones()
    zone = root["Base"]["left"]
    zone.children = [
        *(node for node in zone.children if node.name != "ZoneBC"),
        N("ZoneBC", "", link=("bc.cgns", "/Base/left/ZoneBC")),
    ]
    write_hdf5(Path("e2b_zonebc_link_missing.cgns"), root)


def g3() -> None:
    """A good grid, and a displacement table of points of its wall in a thousandth of its length unit."""
    grid = curved()
    write_grid(grid, "g3.xyz")
    wall = grid.block(0)[0].reshape(-1, 3)
    moves = np.outer(wall[:, 1], [0.02, 0.0, 0.0])
    np.savetxt("e3_table_mm.csv", 1000.0 * np.hstack([wall, moves]), "%.9g", delimiter=",")


def e4() -> None:
    """Two blocks that match, the same with a gap of 0.2 % of a cell, and their wall in thousandths."""
    closed = curved()
    write_grid(closed, "e4_closed.xyz")
    points = closed.points.copy()
    closed.block(1, points)[0, :, :, 0] += 0.002 * 0.25
    write_grid(closed.moved(points), "e4_gap.xyz")
    wall = np.unique(np.concatenate([closed.block(b)[:, 0].reshape(-1, 3) for b in (0, 1)]), axis=0)
    moves = np.outer(np.sin(wall[:, 0]), [0.0, 0.002, 0.0])
    np.savetxt("e3b_wall_mm.csv", 1000.0 * np.hstack([wall, moves]), "%.9g", delimiter=",")


def e5_extra() -> None:
    """More numbers than nodes, behind an element inside the array."""
    more = b'<InformationKey name="L2_NORM_RANGE" location="vtkDataArray"/>1 2 3</DataArray>'
    _ascii("e5_extra.vts", b"</DataArray>", more)


def e6_integers() -> None:
    """Three plane blocks of whole numbers, which have as many numbers as one block in space with IBLANK."""
    shapes = ((2, 5), (2, 8), (8, 4))
    lines = ["3", " ".join(f"{a} {b}" for a, b in shapes)]
    for a, b in shapes:
        j, i = np.divmod(np.arange(a * b), a)
        lines += [" ".join(map(str, i)), " ".join(map(str, j))]
    Path("e6_integers.fmt").write_text("\n".join(lines) + "\n")


def t_bad() -> None:
    """An archive whose packed data are damaged."""
    g3()
    rng = np.random.default_rng(0)
    np.savez_compressed("t_bad.npz", points=rng.integers(0, 9, (400, 3)) * 1.0, displacement=np.zeros((400, 3)))
    data = bytearray(Path("t_bad.npz").read_bytes())
    data[120:160] = bytes(40 * [0xEE])
    Path("t_bad.npz").write_bytes(data)


def _ascii(name: str, old: bytes, new: bytes) -> None:
    write_grid(curved(1), name, {"encoding": "ascii"})
    before, found, behind = Path(name).read_bytes().partition(b"<Points>")
    Path(name).write_bytes(before + found + behind.replace(old, new, 1))


ALL: tuple[Callable[[], None], ...] = (
    c_const, c_deep, c_root, d1_abort, d2_abort, e1_partial, e2_zone, e2b_zonebc, g3, e4, e5_extra, e6_integers, t_bad,
)  # fmt: skip
