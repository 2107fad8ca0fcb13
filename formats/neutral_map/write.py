"""Writing NASA neutral map files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from meshdeform_core.grid import Connection, Grid, Patch, Shape, Side

from ..files import replacing
from .text import FACES

_NUMBERED = {side: (number, axes) for number, (side, axes) in FACES.items()}
_WIDE = "=" * 83
_THIN = "-" * 83

# First and last node (0-based) along each index axis of a face range.
Spans = Mapping[int, tuple[int, int]]


def write_neutral_map(grid: Grid, path: Path) -> None:
    """Write patches and connections of ``grid`` as a neutral map file, replacing ``path`` as a whole.

    Raises
    ------
    FormatError
        When the file cannot be written.
    """
    with replacing(Path(path)) as partial:
        partial.write_text(neutral_map_text(grid), encoding="utf-8")


def neutral_map_text(grid: Grid) -> str:
    """Patches and connections of ``grid`` in the format of neutral map files.

    The type of a patch is its ``bc_type``, else its family or name. A connection that both blocks declare is written
    once; both sides of a periodic one, for which the format has no entry, have the type ``periodic``.
    """
    lines = [f"# ===== Neutral Map File written by meshdeform {'=' * 39}", f"# {_WIDE}"]
    lines += ["# Block#   IDIM   JDIM   KDIM", f"# {_THIN}", f"{grid.n_blocks:8d}", ""]
    lines += [f"{b:8d}{ni:7d}{nj:7d}{nk:7d}" for b, (ni, nj, nk) in enumerate(grid.shapes, 1)]
    lines += ["", f"# {_WIDE}"]
    lines += ["# Type                B1  F1     S1     E1     S2     E2  B2  F2     S1     E1     S2     E2  Swap"]
    lines += [f"# {_THIN}"]
    lines += [line for patch in grid.patches for line in _patch_lines(patch)]
    lines += _connection_lines(grid)
    return "\n".join(lines) + "\n"


def _patch_lines(patch: Patch) -> list[str]:
    word = re.sub(r"[\s#'\"\\]+", "_", patch.bc_type or patch.family or patch.name)
    ranges = [
        _range(w.block, w.side, dict(zip(w.side.tangential, zip(w.low, w.high, strict=True), strict=True)))
        for w in patch.windows
    ]
    # A patched interface is one entry with both its faces.
    if word.lower() == "patched" and len(ranges) == 2:
        ranges = ["".join(ranges)]
    return [f"{word:20s}{text}" for text in ranges]


def _connection_lines(grid: Grid) -> Iterator[str]:
    written = set()
    for connection in grid.connections:
        faces = _faces(connection, grid.shapes[connection.block])
        ends = frozenset((block, *(tuple(sorted(span)) for span in spans.values())) for block, _, spans in faces)
        if ends in written:
            continue
        written.add(ends)
        here, there = (_range(*face) for face in faces)
        if connection.periodic is None:
            (primary, _), (_, donor_secondary) = (_NUMBERED[side][1] for _, side, _ in faces)
            swap = abs(connection.transform[primary]) - 1 == donor_secondary
            yield f"{'one-to-one':20s}{here}{there}  {str(swap).lower()}"
        else:
            yield from (f"{'periodic':20s}{here}", f"{'periodic':20s}{there}")


def _faces(connection: Connection, shape: Shape) -> tuple[tuple[int, Side, Spans], tuple[int, Side, Spans]]:
    """Block, side and range of both sides of a connection."""
    begin, end, donor_begin = connection.begin, connection.end, connection.donor_begin
    axis = next(a for a in range(3) if begin[a] == end[a] and shape[a] > 1 and begin[a] in (0, shape[a] - 1))
    donor_axis = abs(connection.transform[axis]) - 1
    spans = dict(enumerate(zip(begin, end, strict=True)))
    donor_spans = dict(enumerate(zip(donor_begin, connection.donor_end, strict=True)))
    return (
        (connection.block, Side(2 * axis + (begin[axis] > 0)), spans),
        (connection.donor_block, Side(2 * donor_axis + (donor_begin[donor_axis] > 0)), donor_spans),
    )


def _range(block: int, side: Side, spans: Spans) -> str:
    number, (primary, secondary) = _NUMBERED[side]
    limits = (*spans[primary], *spans[secondary])
    return f" {block + 1:3d} {number:3d}" + "".join(f" {limit + 1:6d}" for limit in limits)
