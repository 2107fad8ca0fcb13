"""``meshdeform sample``: write a sample case."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from meshdeform_core.errors import CaseError
from meshdeform_core.wording import counted

from ..checks import check_output, make_folder
from ..options import PATH, RunInput, packed

_BOUNDARY_FILE = "grid.nmf"


@click.command("sample")
@click.argument("name", required=False)
@click.option("-o", "--output", type=PATH, help="Folder for grid and case.toml; created if missing.")
@click.option("--size", help="Size of the grid: a number, whose meaning depends on the sample, or a name like small.")
@click.option(
    "--suffix",
    default=".cgns",
    show_default=True,
    help="Format of the grid, by suffix; for formats that cannot hold boundaries, these are written to grid.nmf.",
)
@packed(RunInput, "run", "variant", "force", "quiet")
def command(name: str | None, output: Path | None, size: str | None, suffix: str, run: RunInput) -> int:
    """Write the sample case NAME into a folder; without NAME, list all samples.

    \b
    Examples:
      meshdeform sample
      meshdeform sample splitter-plate -o case --size 16
      meshdeform sample wing -o case --size small
      meshdeform deform case/grid.cgns -c case/case.toml -o case/deformed.cgns
    """
    from meshdeform_formats.displacement import write_displacement
    from meshdeform_formats.files import replacing
    from meshdeform_formats.grids import format_of, variant_of, write_grid
    from meshdeform_formats.neutral_map import write_neutral_map
    from meshdeform_samples import SAMPLES, folder, generate, load

    if name is None:
        for key in SAMPLES:
            module = load(key)
            names = ", ".join(f"{each} = {number}" for each, number in module.SIZES.items())
            click.echo(f"{key}\n    {(module.__doc__ or '').splitlines()[0]}")
            click.echo(f"    --size: {module.SIZE_HELP}; default {module.DEFAULT_SIZE}; {names}")
        return 0
    load(name)
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    target = output / f"grid{suffix if suffix.startswith('.') else '.' + suffix}"
    kind = format_of(target)
    if kind == "meshio":
        raise CaseError(f"--suffix {suffix}: unstructured grids cannot be deformed; expected Plot3D, VTK or .cgns")
    grid, tables = generate(name, size)
    variant_of(grid, target, run.variant_options)
    boundary_file = None if kind == "cgns" else _BOUNDARY_FILE
    head = f'[grid]\nboundary_file = "{boundary_file}"\n\n' if boundary_file else ""
    written = [file for file in folder(name).iterdir() if file.name.endswith((".toml", ".md"))]
    texts = {file.name: head * file.name.endswith(".toml") + file.read_text(encoding="utf-8") for file in written}
    make_folder(output)
    for file in (target.name, boundary_file or target.name, *tables, *texts):
        check_output(output / file, run.force)
    write_grid(grid, target, run.variant_options)
    if boundary_file:
        # Types are the names that the case selects.
        named = tuple(dataclasses.replace(patch, bc_type="", family=patch.name) for patch in grid.patches)
        write_neutral_map(dataclasses.replace(grid, patches=named), output / boundary_file)
    for file, table in tables.items():
        write_displacement(output / file, table)
    for file, text in texts.items():
        with replacing(output / file) as partial:
            partial.write_text(text, encoding="utf-8")
    if not run.quiet:
        blocks = counted(grid.n_blocks, "block")
        click.echo(f"{target}: {blocks}, {grid.n_nodes:,} nodes; case in {output / 'case.toml'}")
    return 0
