"""``meshdeform init``: create a case file."""

from __future__ import annotations

import os
from pathlib import Path

import click

from meshdeform_core.errors import CaseError

from ..checks import check_output
from ..options import PATH, GridInput, RunInput, grid_options, packed


@click.command("init")
@grid_options
@click.option("-o", "--output", type=PATH, help="Case file to write (default: print it).")
@click.option("--table", type=PATH, help="Displacement table for the wall that it fits.")
@packed(RunInput, "run", "force")
def command(source: GridInput, output: Path | None, table: Path | None, run: RunInput) -> int:
    """Create a case file for GRID: every boundary with its position and likely role.

    \b
    Examples:
      meshdeform init wing.cgns -o case.toml
      meshdeform init airfoil.p3dfmt --boundary-file airfoil.nmf -o case.toml
      meshdeform init wing.cgns --table loads.csv -o case.toml
      meshdeform deform wing.cgns -c case.toml --dry-run

    Boundaries are selected by family or patch, unnamed faces individually. Walls are moving, with a zero motion to fill
    in, or following --table, with a match and tolerance that fit; symmetry planes are symmetry, the end planes of
    extruded grids slip, and the rest is fixed.
    """
    from meshdeform_core.grid.surfaces import find_outside
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_formats.case.template import case_template, fitted_table
    from meshdeform_formats.files import replacing, shown

    if output is not None:
        check_output(output, run.force, *source.files, table)
    grid = source.read()
    map_file = _from(source.boundary_file, output) if source.boundary_file else None
    if map_file is not None and shown(Path(map_file)) != map_file:
        raise CaseError(f"{shown(Path(map_file))}: its name is not UTF-8, so a case file cannot refer to it; rename it")
    topology = find_topology(grid)
    fitted = None if table is None else fitted_table(grid, topology, table, _from(table, output))
    text = case_template(grid, find_outside(grid, topology), shown(source.path), map_file, fitted)
    if output is None:
        click.echo(text, nl=False)
        return 0
    with replacing(output) as partial:
        partial.write_text(text, encoding="utf-8")
    first = "fill in the motion" if fitted is None else "check the boundaries"
    click.echo(f"{output}: {first}, then: meshdeform deform {source.path} -c {output} --dry-run")
    return 0


def _from(file: Path, case: Path | None) -> str:
    """A file name for a case file: relative to the case's folder, unless given as an absolute path."""
    return str(file) if file.is_absolute() else os.path.relpath(file, case.parent if case else Path())
