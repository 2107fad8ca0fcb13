"""A grid larger than the memory against one that fits: nodes per second and peak of ``deform``, file to file."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from blocks import CASE, SIZES, bent, positions
from runs import STAGES, run
from tables import MarkdownTable, Row

_PLANES = 4
"""Planes of nodes that are made at once."""
_JUMPING, _SMOOTH = CASE.splitlines()[4], 'motion = [{ displace = ["0.0", "0.02*x*(1-x)*sin(3*x)*cos(2*z)", "0.0"] }]'
"""Beside boundaries at rest the displacement must be small against the cells of any grid."""


def write_large(folder: Path, count: int, nodes: int) -> Path:
    """The box of :mod:`blocks` as a binary Plot3D file, written a few planes at a time, and its case.

    Parameters
    ----------
    count : blocks
    nodes : of the whole grid, about
    """
    blocks = SIZES[count][0] if count in SIZES else (count, 1, 1)
    n = round((nodes / count) ** (1 / 3))
    file = folder / "grid.p3dbin"
    with file.open("wb") as out:
        np.array([count, *(n,) * 3 * count], "<i4").tofile(out)
        header = out.tell()
        along = [positions(parts, n) for parts in blocks]
        for number, place in enumerate(np.ndindex(*blocks)):
            u, v, w = (lines[start] for lines, start in zip(along, place, strict=True))
            for k in range(0, n, _PLANES):
                part = bent(*np.meshgrid(u, v, w[k : k + _PLANES], indexing="ij"))
                for axis in range(3):
                    out.seek(header + 8 * ((3 * number + axis) * n**3 + k * n**2))
                    part[..., axis].ravel(order="F").astype("<f8").tofile(out)
    (folder / "case.toml").write_text(CASE.replace(_JUMPING, _SMOOTH), encoding="utf-8")
    return file


def larger_than_memory(small: int, large: int, count: int, cap: str, method: str, folder: Path | None) -> MarkdownTable:
    """``deform`` of the same box with few nodes in memory, and with many under a cap."""
    table = MarkdownTable(
        f"Larger than the memory: {method}, {count:,} blocks",
        notes=[
            "binary Plot3D files, two threads, no report but that of the figures; peak: largest resident size of the "
            "process, mapped files included",
            "rate: nodes per second, relative to the first row; by CPU: per processor second of all threads",
        ],
    )
    for nodes, limit in ((small, None), (large, cap)):
        with tempfile.TemporaryDirectory(dir=folder) as name:
            table.rows.append(_measured(write_large(Path(name), count, nodes), limit, method))
            first = table.rows[0]
            row = table.rows[-1]
            row["rate"] = row["nodes"] / row["wall s"] * first["wall s"] / first["nodes"]
            row["rate by CPU"] = row["nodes"] / row["CPU s"] * first["CPU s"] / first["nodes"]
    return table


def _measured(grid: Path, cap: str | None, method: str) -> Row:
    folder, report = grid.parent, grid.parent / "report.json"
    command = [
        sys.executable, "-m", "meshdeform", "deform", str(grid), "-c", f"{folder}/case.toml", "-m", method, "-o",
        f"{folder}/out.p3dbin", "--report", str(report), "-q", "--force", "--threads", "2", "--repair", "off",
    ]  # fmt: skip
    wall, usage = run(command + (["--max-memory", cap] if cap else []))
    facts = json.loads(report.read_text(encoding="utf-8"))
    return {
        "nodes": facts["grid"]["nodes"],
        "cap": cap or "none",
        "peak MiB": usage.ru_maxrss / 1024,
        "wall s": wall,
        "CPU s": usage.ru_utime + usage.ru_stime,
        **{stage: facts["timing"][stage] for stage in STAGES},
    }


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--small", type=float, default=2e7, help="nodes of the grid in memory (%(default)g)")
    parser.add_argument("--large", type=float, default=2e8, help="nodes of the other one (%(default)g)")
    parser.add_argument("--blocks", type=int, choices=SIZES, default=10)
    parser.add_argument("--cap", default="4GiB", help="--max-memory of the other one (%(default)s)")
    parser.add_argument("--method", default="idw-tfi")
    parser.add_argument("--folder", type=Path, help="for the files, 48 bytes per node and as much to work in")
    options = parser.parse_args()
    sizes = int(options.small), int(options.large)
    print(larger_than_memory(*sizes, options.blocks, options.cap, options.method, options.folder).markdown())


if __name__ == "__main__":
    main()
