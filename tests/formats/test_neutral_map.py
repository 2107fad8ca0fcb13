"""Neutral map files: those of NASA, every way two faces can meet, and what is refused."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from grids import joined_nodes, transform_matrix, whole_face

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, Patch, Periodicity, Side, Window
from meshdeform_formats.neutral_map import read_neutral_map, write_neutral_map


def lattice(*shape: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Block of a unit lattice: node (i, j, k) lies at origin + (i, j, k)."""
    return np.stack(np.indices(shape), axis=-1) + np.array(origin)


def put(folder: Path, *lines: str) -> Path:
    path = folder / "grid.nmf"
    path.write_text("# a map\n" + "\n".join(lines) + "\n")
    return path


def gap(grid: Grid, connection: Connection) -> float:
    """Largest distance between the nodes that a connection says are the same."""
    nodes, donors = joined_nodes(grid, connection)
    return float(np.abs(nodes - donors).max())


# Face number: constant index, whether at its end, primary and secondary index.
FACES = {1: (2, 0, 0, 1), 2: (2, 1, 0, 1), 3: (0, 0, 1, 2), 4: (0, 1, 1, 2), 5: (1, 0, 2, 0), 6: (1, 1, 2, 0)}


def neighbours(face: int, donor_face: int, swap: bool, back: bool, *flips: bool) -> tuple[np.ndarray, np.ndarray, str]:
    """Two blocks of one unit lattice that share a face, the second one turned, and the entry that says so; the range
    of the primary index of the first one goes up or ``back``."""
    axis, far, *tangential = FACES[face]
    donor_axis, donor_far, *donor_tangential = FACES[donor_face]
    shape = np.zeros(3, int)
    shape[[axis, *tangential]] = 3, 4, 5
    # Where the indices of the donor lead, in those of the block.
    leads = dict(zip([donor_axis, *donor_tangential], [axis, *(tangential[::-1] if swap else tangential)], strict=True))
    flipped = {axis: donor_far == far, **dict(zip(tangential, flips, strict=True))}
    shifted = lattice(*shape) + np.eye(3)[axis] * (2 if far else -2)
    donor = np.transpose(shifted, [leads[0], leads[1], leads[2], 3])
    donor = np.flip(donor, [index for index, lead in leads.items() if flipped[lead]])
    turned = {tangential[0]: back, tangential[1]: False}
    first = [f"{shape[i]} 1" if turned[i] else f"1 {shape[i]}" for i in tangential]
    reached = [(shape[leads[i]], flipped[leads[i]] != turned[leads[i]]) for i in donor_tangential]
    second = [f"{n} 1" if descending else f"1 {n}" for n, descending in reached]
    return lattice(*shape), donor, " ".join(["1", str(face), *first, "2", str(donor_face), *second, str(swap)])


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("donor_face", FACES)
def test_all_ways_two_faces_can_meet(tmp_path, face, donor_face):
    for swap, back, *flips in itertools.product((False, True), repeat=4):
        block, donor, entry = neighbours(face, donor_face, swap, back, *flips)
        bare = Grid.from_blocks([block, donor])
        sizes = [f"{n} {' '.join(map(str, b.shape[:3]))}" for n, b in ((1, block), (2, donor))]
        grid = read_neutral_map(put(tmp_path, "2", *sizes, f"ONE_TO_ONE {entry}"), bare)
        (connection,) = grid.connections
        assert gap(grid, connection) == 0.0
        axis, far = FACES[face][:2]
        outward = np.eye(3, dtype=int)[axis] * (1 if far else -1)
        beyond = np.array(connection.donor_begin) + transform_matrix(connection) @ outward
        assert np.array_equal(donor[tuple(beyond)], block[connection.begin] + outward)
        write_neutral_map(grid, tmp_path / "out.nmf")
        (again,) = read_neutral_map(tmp_path / "out.nmf", bare).connections
        assert dataclasses.replace(again, name=connection.name) == connection


def test_quotes_comments_flags_and_types_with_two_faces(tmp_path):
    path = put(
        tmp_path,
        "2 # blocks \\\n\n 2 3 4 6 \\\n 1 3 4 5",
        "'viscous solid' 1 3 1 4 1 5   TRUE",
        '"wall" 2 4 4 1 6 2 \\',
        "Patched 1 2 1 3 1 4 2 1 1 3 1 4",
        "WALL 1 5 1 5 1 3 # not the same word",
    )
    known = Patch("mine", (Window(0, Side.JMAX, (0, 0), (2, 4)),), "wall")
    grid = read_neutral_map(path, Grid.from_blocks([lattice(3, 4, 5), lattice(3, 4, 6)], patches=(known,)))
    assert [patch.name for patch in grid.patches] == ["mine", "viscous solid-1", "wall-2", "Patched-1", "WALL-1"]
    assert grid.patches[2].windows == (Window(1, Side.IMAX, (0, 1), (3, 5)),)
    assert grid.patches[3].windows == (Window(0, Side.KMAX, (0, 0), (2, 3)), Window(1, Side.KMIN, (0, 0), (2, 3)))
    assert grid.connections == ()
    write_neutral_map(grid, tmp_path / "out.nmf")
    text = (tmp_path / "out.nmf").read_text()
    back = read_neutral_map(tmp_path / "out.nmf", Grid.from_blocks([lattice(3, 4, 5), lattice(3, 4, 6)]))
    assert [patch.windows for patch in back.patches] == [patch.windows for patch in grid.patches]
    assert "viscous_solid" in text
    assert sum("Patched" in line for line in text.splitlines()) == 1


def test_edges_and_faces_of_a_2d_grid(tmp_path):
    lines = ("1", "7 9 4 1", "FARFIELD 1 1 1 4 1 1", "FARFIELD 1 2 1 4 1 1", "VISCOUS 1 3 3 7 1 1  TRUE")
    lines += ("FARFIELD 1 4 1 9 1 1", "ONE_TO_ONE 1 3 1 3 1 1 1 3 9 7 1 1 FALSE")
    grid = read_neutral_map(put(tmp_path, *lines), Grid.from_blocks([lattice(9, 4, 1)]))
    assert [(patch.name, patch.windows[0]) for patch in grid.patches] == [
        ("FARFIELD-1", Window(0, Side.IMIN, (0, 0), (3, 0))),
        ("FARFIELD-2", Window(0, Side.IMAX, (0, 0), (3, 0))),
        ("VISCOUS-1", Window(0, Side.JMIN, (2, 0), (6, 0))),
        ("FARFIELD-3", Window(0, Side.JMAX, (0, 0), (8, 0))),
    ]
    assert grid.connections[0].transform == (-1, -2, 3)
    assert grid.notes[0].endswith("the block numbers [7] are not 1 to 1; taken in file order")
    with pytest.raises(FormatError, match="block 1 has 2x2x5 nodes, block1 of the grid has 2x5x1"):
        read_neutral_map(put(tmp_path, "1", "1 2 2 5"), Grid.from_blocks([lattice(2, 5, 1)]))
    assert (grid.connections[0].begin, grid.connections[0].donor_begin) == ((0, 0, 0), (8, 0, 0))


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("dropped", range(3))
@pytest.mark.parametrize("flat", range(3))
def test_faces_in_space_of_a_plane_in_any_order_with_or_without_a_layer(tmp_path, flat, dropped, layers):
    sizes, shape = (np.insert([9, 4], axis, n).tolist() for axis, n in ((dropped, layers), (flat, 1)))
    faces = {n: f"1 {n} 1 {sizes[one]} 1 {sizes[two]}" for n, (_, _, one, two) in FACES.items()}
    own = dict(zip(np.delete(range(3), dropped).tolist(), np.delete(range(3), flat).tolist(), strict=True))
    sides = [Side(2 * own[axis] + far) for axis, far, *_ in FACES.values() if axis != dropped]
    across, along = (next(n for n in FACES if (FACES[n][0] == dropped) == wanted) for wanted in (True, False))
    entries = [f"wall {face}" for face in faces.values()] + [f"Patched {faces[across]} {faces[along]}"]
    lines = "1", f"1 {sizes[0]} {sizes[1]} {sizes[2]}", *entries
    grid = read_neutral_map(put(tmp_path, *lines), Grid.from_blocks([lattice(*shape)]))
    assert [patch.windows for patch in grid.patches] == [(whole_face(tuple(shape), 0, side),) for side in sides]
    assert grid.notes[0].endswith(": 3 entries lie on the plane of the 2-D grid itself and are ignored")


def test_connections_of_both_blocks_and_periodic_ones_are_written(tmp_path):
    blocks = [lattice(3, 4, 5), lattice(2, 4, 5, origin=(2.0, 0.0, 0.0))]
    there = Connection("a", 0, (2, 0, 0), (2, 3, 4), 1, (0, 0, 0), (0, 3, 4), (1, 2, 3))
    back = Connection("b", 1, (0, 3, 0), (0, 0, 4), 0, (2, 3, 0), (2, 0, 4), (1, 2, 3))
    around = Connection("c", 0, (0, 0, 0), (0, 3, 4), 1, (1, 0, 0), (1, 3, 4), (1, 2, 3), Periodicity())
    walls = [whole_face((3, 4, 5), 0, side) for side in (Side.KMIN, Side.KMAX, Side.JMIN)]
    names = ("a 'b'\t#\\",), ("w1", "wing"), ("w2", "wing", "wall")
    patches = tuple(Patch(name, (wall,), *types) for (name, *types), wall in zip(names, walls, strict=True))
    grid = Grid.from_blocks(blocks, connections=(there, back, around), patches=patches)
    write_neutral_map(grid, tmp_path / "out.nmf")
    read = read_neutral_map(tmp_path / "out.nmf", Grid.from_blocks(blocks))
    assert [(c.block, c.begin, c.transform) for c in read.connections] == [(0, (2, 0, 0), (1, 2, 3))]
    ends = whole_face((3, 4, 5), 0, Side.IMIN), whole_face((2, 4, 5), 1, Side.IMAX)
    assert [patch.windows for patch in read.patches] == [(window,) for window in (*walls, *ends)]
    assert [patch.bc_type for patch in read.patches] == ["a_b_", "wing", "wall", "periodic", "periodic"]


BAD = {
    "empty": ([""], "is not a neutral map: it has only comments"),
    "no count": (["wall 1 1 1 3 1 4"], "line 2: expected the number of blocks, found 'wall 1 1 1 3 1 4'"),
    "sizes missing": (["2", "1 3 4 5"], "declares 2 blocks but ends after the sizes of 1"),
    "entries among the sizes": (["2", "1 3 4 5", "wall 1 1 1 3 1 4"], "line 4: expected block number, IDIM.*'wall 1 1"),
    "other number of blocks": (["2", "1 3 4 5", "2 3 4 5"], "describes 2 blocks, the grid has 1"),
    "other sizes": (["1", "1 3 5 5"], r"block 1 has 3x5x5 nodes, block1 of the grid has 3x4x5; expected the map"),
    "too few numbers": (["1", "1 3 4 5", "wall 1 1 1 3 1"], "line 4: wall has 5 numbers; a face range has 6"),
    "a word among the numbers": (["1", "1 3 4 5", "wall 1 kmin 1 3 1 4"], "line 4: expected after the type .*'1 kmin"),
    "unknown block": (["1", "1 3 4 5", "wall 2 1 1 3 1 4"], "line 4: block 2 does not exist; .* blocks 1 to 1"),
    "block 0": (["1", "1 3 4 5", "wall 0 1 1 3 1 4"], "line 4: block 0 does not exist"),
    "unknown face": (["1", "1 3 4 5", "wall 1 7 1 3 1 4"], "line 4: face 7 does not exist; faces are 1 to 6"),
    "range too large": (
        ["1", "1 3 4 5", "wall 1 5 1 6 1 3"],
        r"line 4: range 1 to 6 along k on face 5 \(jmin\) of block 1, which has nodes 1 to 5 there",
    ),
    "no donor": (["1", "1 3 4 5", "one-to-one 1 1 1 3 1 4 false"], "line 4: one-to-one needs two face ranges and Swap"),
    "ranges of two lengths": (
        ["1", "1 3 4 5", "one-to-one 1 1 1 3 1 4 1 2 1 3 1 3 false"],
        "line 4: 4 nodes of block 1 along j meet 3 of block 1 along j; check the ranges and Swap",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_maps(tmp_path, name):
    lines, message = BAD[name]
    path = put(tmp_path, *lines)
    with pytest.raises(FormatError, match=message) as caught:
        read_neutral_map(path, Grid.from_blocks([lattice(3, 4, 5)]))
    assert str(path) in str(caught.value)
