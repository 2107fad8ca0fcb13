"""``meshdeform convert``: from any readable to any writable format."""

from __future__ import annotations

from pathlib import Path

import click

from .messages import tell
from .options import (
    PATH,
    GridInput,
    check_output,
    force_option,
    grid_options,
    parse_pairs,
    quiet_option,
    variant_option,
)


@click.command("convert")
@grid_options
@click.argument("target", metavar="OUT", type=PATH)
@variant_option
@force_option
@quiet_option
def command(source: GridInput, target: Path, variant: tuple[str, ...], force: bool, quiet: bool) -> int:
    """Convert GRID to the format that the suffix of OUT stands for.

    \b
    Examples:
      meshdeform convert wing.cgns wing.vtm
      meshdeform convert grid.xyz grid.p3dfmt
      meshdeform convert grid.xyz big.xyz --variant byte_order=big --variant precision=float32
      meshdeform convert airfoil.p3dfmt airfoil.cgns --boundary-file airfoil.nmf
    """
    from meshdeform_formats.grids import complete_for_export, format_of, write_grid

    format_of(target)
    options = parse_pairs(variant, "--variant")
    check_output(target, force, *source.files)
    grid = complete_for_export(source.read(), target)
    written = write_grid(grid, target, options)
    for note in grid.notes:
        tell(f"warning: {note}")
    if not quiet:
        click.echo(f"{target}: {written.label}, {grid.n_blocks} blocks, {grid.n_nodes:,} nodes")
    return 0
