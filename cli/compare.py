"""``meshdeform compare``: how far two grids are apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from meshdeform_core.errors import GridError

from .options import PATH, FiniteNumber, json_option

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid

EXIT_DIFFERENT = 1


@click.command("compare")
@click.argument("first", metavar="A", type=PATH)
@click.argument("second", metavar="B", type=PATH)
@click.option("--tolerance", type=FiniteNumber(min=0.0), help="Exit 1 if any coordinate differs by more.")
@json_option
def command(first: Path, second: Path, tolerance: float | None, as_json: bool) -> int:
    """Compare the coordinates of two grids with the same blocks, in any formats.

    \b
    Examples:
      meshdeform compare a.cgns b.xyz
      meshdeform compare restart.xyz reference.xyz --tolerance 1e-10 && echo same

    Prints the largest and the rms distance of corresponding nodes, overall and per block, and where the largest is.
    """
    import numpy as np

    from meshdeform_formats import read_grid

    a, b = read_grid(first), read_grid(second)
    require_same_blocks(a, b, first, second)
    distance = np.linalg.norm(a.points - b.points, axis=1)
    worst = int(np.argmax(distance))
    largest = float(distance[worst])
    facts = {
        "largest": largest,
        "rms": float(np.sqrt(np.mean(distance**2))),
        "where": a.node_label(worst),
        "differing_nodes": int(np.count_nonzero(distance)),
        "nodes": a.n_nodes,
        "blocks": [
            {"name": name, "largest": float(part.max()), "rms": float(np.sqrt(np.mean(part**2)))}
            for name, part in zip(a.names, (a.block(n, distance[:, None]) for n in range(a.n_blocks)), strict=True)
        ],
    }
    click.echo(json.dumps(facts, indent=2) if as_json else _text(facts))
    return EXIT_DIFFERENT if tolerance is not None and largest > tolerance else 0


def require_same_blocks(a: Grid, b: Grid, first: Path, second: Path) -> None:
    """Refuse two grids whose nodes do not correspond.

    Raises
    ------
    GridError
        With the number of blocks, or the first block that differs.
    """
    if a.n_blocks != b.n_blocks:
        difference = f"{first} has {a.n_blocks} blocks, {second} has {b.n_blocks}"
    elif a.shapes != b.shapes:
        n = next(n for n, shapes in enumerate(zip(a.shapes, b.shapes, strict=True)) if shapes[0] != shapes[1])
        one, two = (" x ".join(map(str, grid.shapes[n])) for grid in (a, b))
        difference = f"{a.names[n]} of {first} has {one} nodes, block {n + 1} of {second} has {two}"
    else:
        return
    raise GridError(f"{difference}; expected the same blocks in the same order")


def _text(facts: dict) -> str:
    lines = [
        f"largest {facts['largest']:.6e} at {facts['where']}",
        f"rms     {facts['rms']:.6e}, {facts['differing_nodes']:,} of {facts['nodes']:,} nodes differ",
    ]
    lines += [f"  {b['name']}: largest {b['largest']:.3e}, rms {b['rms']:.3e}" for b in facts["blocks"]]
    return "\n".join(lines)
