"""PLY surfaces written value by value with ``struct``."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.errors import FormatError
from meshdeform_formats.displacement import read_displacement

RNG = np.random.default_rng(3)
ROWS = RNG.normal(size=(9, 6)).astype(np.float32)
FACES = [[0, 1, 2], [0, 1, 2, 3], [4, 5, 6, 7], [1, 2, 8], [5, 6, 7], [0, 1, 2, 3, 4]]
TRIANGLES = [[f[0], *f[n : n + 2]] for f in FACES for n in range(1, len(f) - 1)]
HEAD = """element vertex 9
property float x
property float y
property float z
property float ux
property float uy
property float32 uz
element face 6
property uchar red
property list uchar int vertex_index
property short q
element edge 2
property int a
property int b
end_header
"""


def text() -> bytes:
    lines = ["ply", "format ascii 1.0", "comment by hand", *HEAD.splitlines()]
    lines += [" ".join(map(repr, row)) for row in ROWS.tolist()]
    lines += [f"7 {len(face)} {' '.join(map(str, face))} -3" for face in FACES]
    return "\n".join([*lines, "1 2", "3 4", ""]).encode()


def binary(order: str, name: str) -> bytes:
    faces = b"".join(struct.pack(f"{order}BB{len(face)}ih", 7, len(face), *face, -3) for face in FACES)
    rows = ROWS.astype(order + "f4").tobytes()
    return (
        f"ply\nformat binary_{name}_endian 1.0\n{HEAD}".encode() + rows + faces + struct.pack(order + "4i", 1, 2, 3, 4)
    )


FILES = {"text": text(), "little": binary("<", "little"), "big": binary(">", "big")}


@pytest.mark.parametrize("data", FILES.values(), ids=FILES)
def test_polygons_of_any_size_among_other_properties(data, tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    found = read_displacement(path)
    np.testing.assert_array_equal(found.points, ROWS[:, :3])
    np.testing.assert_array_equal(found.displacement, ROWS[:, 3:])
    assert found.triangles.tolist() == TRIANGLES


@pytest.mark.parametrize("data", FILES.values(), ids=FILES)
def test_every_truncated_file_is_refused(data, tmp_path):
    path = tmp_path / "a.ply"
    for size in range(0, len(data) - 2, 7):
        path.write_bytes(data[:size])
        with pytest.raises(FormatError):
            read_displacement(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"7 3 0 1 2", b"7 2 0 1 2"),
        (b"7 3 0 1 2", b"7 34 1 2"),
        (b"7 3 0 1 2", b"7 3 0 1 2.5"),
        (b"7 3 0 1 2", b"7 3 0 1 0_2"),
        (b"7 3 0 1 2", b"7 3 0 1 9"),
        (b"7 3 0 1 2", b"7 3 0 1 nan"),
        (b"7 3 0 1 2", b"7 -3 0 1 2"),
        (b"element vertex 9", b"element vertex 8"),
        (b"element vertex 9", b"element vertex -9"),
        (b"element edge 2", b"element edge 1"),
        (b"property float y", b"property float x"),
        (b"property float x", b"property quad x"),
        (b"format ascii 1.0", b"format ascii 2.0"),
        (b"element face 6", b"element vertex 6"),
        (b"end_header", b"end"),
    ],
)
def test_what_the_header_does_not_announce_is_refused(old, new, tmp_path):
    """meshio takes the points that are there, and faces whose rows are too short."""
    path = Path(tmp_path / "a.ply")
    assert FILES["text"].count(old) >= 1
    path.write_bytes(FILES["text"].replace(old, new, 1))
    with pytest.raises(FormatError):
        read_displacement(path)
