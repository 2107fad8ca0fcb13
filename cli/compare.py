"""``meshdeform compare``: how far two grids are apart."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from meshdeform_core.errors import GridError

from .options import PATH, json_option

EXIT_DIFFERENT = 1


@click.command("compare")
@click.argument("first", metavar="A", type=PATH)
@click.argument("second", metavar="B", type=PATH)
@click.option("--tolerance", type=click.FloatRange(min=0.0), help="Exit 1 if any coordinate differs by more.")
@json_option
def command(first: Path, second: Path, tolerance: float | None, as_json: bool) -> int:
    """Compare the coordinates of two grids with the same blocks, in any formats.

    \b
    Examples:
      meshdeform compare a.cgns b.xyz
      meshdeform compare restart.xyz reference.xyz --tolerance 1e-10 && echo same

    Prints the largest and the rms distance of corresponding nodes, overall and per block, and where the largest is.
    """
    from meshdeform_formats import read_grid

    a, b = read_grid(first), read_grid(second)
    if a.shapes != b.shapes:
        raise GridError(f"{first} has blocks {list(a.shapes)}, {second} has {list(b.shapes)}; expected the same blocks")
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


def _text(facts: dict) -> str:
    lines = [
        f"largest {facts['largest']:.6e} at {facts['where']}",
        f"rms     {facts['rms']:.6e}, {facts['differing_nodes']:,} of {facts['nodes']:,} nodes differ",
    ]
    lines += [f"  {b['name']}: largest {b['largest']:.3e}, rms {b['rms']:.3e}" for b in facts["blocks"]]
    return "\n".join(lines)
