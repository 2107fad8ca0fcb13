"""``meshdeform compare``: distance between two grids."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import click

from meshdeform_core.memory import passing

from ..checks import make_room, temporary_folder
from ..options import PATH, FiniteNumber, GridInput, RunInput, packed

EXIT_DIFFERENT = 1
# Memory in units of the coordinates of both grids: these, the distances, and buffers of reading.
_ARRAYS = 1.5


@click.command("compare")
@click.argument("first", metavar="A", type=PATH)
@click.argument("second", metavar="B", type=PATH)
@click.option("--tolerance", type=FiniteNumber(min=0.0), help="Exit 1 if any coordinate differs by more.")
@packed(RunInput, "run", "max_memory", "as_json")
def command(first: Path, second: Path, tolerance: float | None, run: RunInput) -> int:
    """Compare the coordinates of two grids with the same blocks, in any formats.

    \b
    Examples:
      meshdeform compare a.cgns b.xyz
      meshdeform compare restart.xyz reference.xyz --tolerance 1e-10 && echo same

    Prints the largest and rms distances between corresponding nodes, overall and per block, and the location of the
    largest.
    """
    from meshdeform_core.quality.difference import compare_points
    from meshdeform_formats import read_grid

    sources = [GridInput(path) for path in (first, second)]
    make_room(run.limit, "comparing", passing(_ARRAYS), sources, temporary_folder())
    difference = compare_points(read_grid(first), read_grid(second))
    if run.as_json:
        click.echo(json.dumps(dataclasses.asdict(difference), indent=2))
    else:
        click.echo(f"largest {difference.largest:.6e} at {difference.where}")
        nodes = f"{difference.differing_nodes:,} of {difference.nodes:,} nodes differ"
        click.echo(f"rms     {difference.rms:.6e}, {nodes}")
        for block in difference.blocks:
            click.echo(f"  {block.name}: largest {block.largest:.3e}, rms {block.rms:.3e}")
    return EXIT_DIFFERENT if tolerance is not None and difference.largest > tolerance else 0
