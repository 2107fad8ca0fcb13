"""Plot3D files written value by value with ``struct``: what the format is, said once more and independently."""

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

ENCODINGS = [
    {"encoding": "binary"},
    {"encoding": "fortran", "markers": 4, "records": "block"},
    {"encoding": "fortran", "markers": 8, "records": "block"},
    {"encoding": "fortran", "markers": 4, "records": "array"},
    {"encoding": "fortran", "markers": 8, "records": "array"},
    {"encoding": "fortran", "markers": 4, "records": "plane"},
]


def sample_blocks(shapes: Sequence[tuple[int, int, int]], precision: str = "float64") -> list[np.ndarray]:
    """Blocks of irregular coordinates that ``precision`` holds exactly; z = 0 in blocks of one plane."""
    rng = np.random.default_rng(7)
    blocks = [rng.uniform(-2, 2, (*shape, 3)).astype(precision).astype(np.float64) for shape in shapes]
    for block in blocks:
        if block.shape[2] == 1:
            block[..., 2] = 0.0
    return blocks


def sample_iblank(shapes: Sequence[tuple[int, int, int]]) -> list[np.ndarray]:
    rng = np.random.default_rng(8)
    return [rng.integers(-3, 3, shape).astype(np.int32) for shape in shapes]


def binary_file(blocks: list[np.ndarray], iblank: list[np.ndarray] | None = None, **variant: Any) -> bytes:
    """The bytes of a C binary or Fortran file."""
    order = ">" if variant.get("byte_order") == "big" else "<"
    dimension = variant.get("dimension", 3)
    sizes = [n for block in blocks for n in block.shape[:dimension]]
    header = [[len(blocks)]] if variant.get("multiblock", True) else []
    records = [struct.pack(f"{order}{len(integers)}i", *integers) for integers in [*header, sizes]]
    for index, block in enumerate(blocks):
        flags = iblank[index] if iblank else None
        records += data_records(block, flags, order, dimension, variant)
    if variant["encoding"] == "binary":
        return b"".join(records)
    return b"".join(fortran_record(record, order, variant.get("markers", 4)) for record in records)


def data_records(
    block: np.ndarray, flags: np.ndarray | None, order: str, dimension: int, variant: dict[str, Any]
) -> Iterator[bytes]:
    letter = "f" if variant.get("precision") == "float32" else "d"
    ni, nj, nk = block.shape[:3]
    planes = [[k] for k in range(nk)] if variant.get("records") == "plane" else [list(range(nk))]
    for levels in planes:
        nodes = [(i, j, k) for k in levels for j in range(nj) for i in range(ni)]
        arrays = [b"".join(struct.pack(order + letter, block[node][c]) for node in nodes) for c in range(dimension)]
        if flags is not None:
            arrays.append(b"".join(struct.pack(order + "i", flags[node]) for node in nodes))
        yield from arrays if variant.get("records") == "array" else [b"".join(arrays)]


def fortran_record(data: bytes, order: str = "<", markers: int = 4, longest: int | None = None) -> bytes:
    """A record, in subrecords of at most ``longest`` bytes (gfortran manual, "File format of unformatted ...")."""
    letter = "i" if markers == 4 else "q"
    parts = [data[start : start + (longest or len(data))] for start in range(0, len(data), longest or len(data))]
    content = b""
    for number, part in enumerate(parts):
        before = -len(part) if number < len(parts) - 1 else len(part)
        after = -len(part) if number > 0 else len(part)
        content += struct.pack(order + letter, before) + part + struct.pack(order + letter, after)
    return content


def ascii_file(
    blocks: list[np.ndarray], iblank: list[np.ndarray] | None = None, multiblock: bool = True, dimension: int = 3
) -> str:
    """The text of a file, one array per line."""
    lines = [str(len(blocks))] if multiblock else []
    lines += [" ".join(str(n) for n in block.shape[:dimension]) for block in blocks]
    for index, block in enumerate(blocks):
        lines += [" ".join(repr(float(x)) for x in block[..., c].ravel(order="F")) for c in range(dimension)]
        if iblank:
            lines.append(" ".join(str(int(flag)) for flag in iblank[index].ravel(order="F")))
    return "\n".join(lines) + "\n"
