"""``meshdeform convert``: from any readable to any writable format."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from meshdeform_core.errors import FormatError
from meshdeform_core.wording import counted

from ..measures import measured
from ..options import (
    OUTPUT,
    PATH,
    GridInput,
    field_option,
    force_option,
    grid_options,
    memory_option,
    parse_pairs,
    quiet_option,
    variant_option,
)
from ..outputs import check_output
from ..process.messages import tell
from ..process.progress import ProgressBar, writing
from ..room import limit_of, make_room

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid


# Memory in units of the coordinates: these, and buffers of reading and writing; the same with fields.
_ARRAYS, _FIELD_ARRAYS = 2, 5


@click.command("convert")
@grid_options
@click.argument("target", metavar="OUT", type=OUTPUT)
@field_option
@click.option("--reference", type=PATH, help="The undeformed grid, for fields that compare with it.")
@variant_option
@memory_option
@force_option
@quiet_option
def command(
    source: GridInput, target: Path, fields: tuple[str, ...], reference: Path | None, variant: tuple[str, ...],
    max_memory: str | None, force: bool, quiet: bool,
) -> int:  # fmt: skip
    """Convert GRID to the format given by the suffix of OUT.

    \b
    Examples:
      meshdeform convert wing.cgns wing.vtm
      meshdeform convert grid.xyz grid.p3dfmt
      meshdeform convert grid.xyz big.xyz --variant byte_order=big --variant precision=float32
      meshdeform convert airfoil.p3dfmt airfoil.cgns --boundary-file airfoil.nmf
      meshdeform convert bent.cgns bent.vtm --reference wing.cgns --field displacement --field f_skew

    Plot3D and VTK files cannot hold boundaries: these are written next to OUT as a neutral map file (.nmf) whose types
    are the names of families or patches.
    """
    from meshdeform_formats.fields import check_fields, with_fields
    from meshdeform_formats.grids import complete_for_export, format_of, write_grid
    from meshdeform_formats.placing import existing

    kind = format_of(target)
    options = parse_pairs(variant, "--variant")
    check_output(target, force, *source.files, reference)
    check_fields(fields, target, reference is not None)
    sources = [source, *([GridInput(reference, None, ())] if reference else [])]
    arrays = _ARRAYS + (_FIELD_ARRAYS if fields else 0)
    make_room(limit_of(max_memory), "converting", sources, existing(target.absolute().parent), arrays)
    with ProgressBar(not quiet, compiles=bool(fields)) as progress:
        grid = complete_for_export(source.read(), target)
        if fields:
            progress("quality", 0, 0)
            grid = with_fields(measured(grid, reference), fields)
        boundaries = _beside(grid, kind, target)
        if boundaries is not None and not _is_there(grid, boundaries):
            _check_boundaries(boundaries, target, force, *source.files)
        with writing(grid.points.nbytes):
            written = write_grid(grid, target, options)
        if boundaries is not None and not _is_there(grid, boundaries):
            _write_boundaries(grid, boundaries)
    for note in grid.notes:
        tell(f"warning: {note}")
    if target.suffix.lower() in (".vtu", ".xdmf") and options.get("boundary") != "true" and grid.patches:
        tell(
            f"warning: {target.suffix} files cannot hold the {len(grid.patches)} patches of the grid; add the outside "
            "faces with their families by --variant boundary=true"
        )
    if not quiet:
        beside = f"; boundaries in {boundaries}" if boundaries is not None else ""
        click.echo(f"{target}: {written.label}, {counted(grid.n_blocks, 'block')}, {grid.n_nodes:,} nodes{beside}")
    return 0


def _beside(grid: Grid, kind: str, target: Path) -> Path | None:
    """The neutral map file for boundaries, if the target format cannot hold them."""
    return target.with_suffix(".nmf") if kind in ("plot3d", "vtk") and (grid.patches or grid.connections) else None


def _is_there(grid: Grid, path: Path) -> bool:
    """Whether the file already holds these boundaries, as after a conversion of the same grid to another format."""
    from meshdeform_formats.neutral_map import neutral_map_text

    try:
        return path.is_file() and path.read_bytes() == neutral_map_text(_by_name(grid)).encode("utf-8")
    except OSError:
        return False


def _check_boundaries(path: Path, target: Path, force: bool, *inputs: Path | None) -> None:
    """Refuse to replace a file with other boundaries."""
    try:
        check_output(path, force, *inputs)
    except FormatError as error:
        raise FormatError(
            f"{error}. {target.suffix} files cannot hold boundaries, which are therefore written next to {target} as "
            f"{path.name}, but that file has other content"
        ) from error


def _write_boundaries(grid: Grid, path: Path) -> None:
    from meshdeform_formats.neutral_map import write_neutral_map

    write_neutral_map(_by_name(grid), path)


def _by_name(grid: Grid) -> Grid:
    """The grid with the families or names of its patches as their types, so that case files remain usable."""
    named = (dataclasses.replace(patch, bc_type=patch.family or patch.name) for patch in grid.patches)
    return dataclasses.replace(grid, patches=tuple(named))
