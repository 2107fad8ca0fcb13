"""``meshdeform info``: contents of a grid file."""

from __future__ import annotations

from pathlib import Path

import click

from meshdeform_core.memory import passing

from ..options import PATH, GridInput, force_option, grid_options, json_option, memory_option
from ..outputs import check_output
from ..room import limit_of, make_room, temporary_folder

# Memory in units of the coordinates: these, and buffers of reading.
_ARRAYS = 1.5


@click.command("info")
@grid_options
@click.option("-v", "--verbose", is_flag=True, help="List every patch and face on its own line.")
@click.option("--picture", type=PATH, help="Draw the boundaries by name (.png .svg .pdf).")
@memory_option
@force_option
@json_option
def command(
    source: GridInput, verbose: bool, picture: Path | None, max_memory: str | None, force: bool, as_json: bool
) -> int:
    """Show the contents of GRID: blocks, walls and other boundaries, interfaces, anomalies.

    \b
    Examples:
      meshdeform info wing.cgns
      meshdeform info airfoil.p3dfmt --boundary-file airfoil.nmf
      meshdeform info grid.vts --json
      meshdeform info wing.cgns --picture wing.png

    The role of a boundary is the one that the file declares. Otherwise it is guessed from the shape of the grid (cells
    cluster towards walls and grow towards the far field) and marked with a question mark.
    """
    if picture is not None:
        from meshdeform_formats.picture.page import check_picture_path

        check_picture_path(picture)
        check_output(picture, force, *source.files)
    make_room(limit_of(max_memory), "describing", passing(_ARRAYS), [source], temporary_folder())
    grid = source.read()

    from meshdeform_formats.text import json_text

    from ..facts import as_text, gather

    facts = gather(grid, str(source.path))
    if picture is not None:
        from meshdeform_core.grid.topology import find_topology
        from meshdeform_formats.picture.overview import boundaries
        from meshdeform_formats.picture.page import save_page
        from meshdeform_formats.picture.subject import Subject

        save_page(boundaries(Subject(grid, find_topology(grid)), source.path.name), picture)
    click.echo(json_text(facts) if as_json else as_text(facts, verbose))
    return 0
