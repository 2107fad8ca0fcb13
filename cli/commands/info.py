"""``meshdeform info``: contents of a grid file."""

from __future__ import annotations

import click

from meshdeform_core.memory import passing

from ..checks import make_room, temporary_folder
from ..options import GridInput, RunInput, grid_options, packed

# Memory in units of the coordinates: these, and buffers of reading.
_ARRAYS = 1.5


@click.command("info")
@grid_options
@click.option("-v", "--verbose", is_flag=True, help="List every patch and face on its own line.")
@packed(RunInput, "run", "max_memory", "as_json")
def command(source: GridInput, verbose: bool, run: RunInput) -> int:
    """Show the contents of GRID: blocks, walls and other boundaries, interfaces, anomalies.

    \b
    Examples:
      meshdeform info wing.cgns
      meshdeform info airfoil.p3dfmt --boundary-file airfoil.nmf
      meshdeform info grid.vts --json

    The role of a boundary is the one that the file declares. Otherwise it is guessed from the shape of the grid (cells
    cluster towards walls and grow towards the far field) and marked with a question mark.
    """
    make_room(run.limit, "describing", passing(_ARRAYS), [source], temporary_folder())
    grid = source.read()

    from meshdeform_formats.text import json_text

    from ..facts import as_text, gather

    facts = gather(grid, str(source.path))
    click.echo(json_text(facts) if run.as_json else as_text(facts, verbose))
    return 0
