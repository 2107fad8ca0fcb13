"""``meshdeform convert``: from any readable to any writable format."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from meshdeform_core.errors import FormatError
from meshdeform_core.memory import passing
from meshdeform_core.wording import counted

from ..checks import check_output, make_room
from ..options import OUTPUT, PATH, GridInput, RunInput, grid_options, packed
from ..process.messages import tell
from ..process.progress import ProgressBar, stage

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid


# Memory in units of the coordinates: these, and buffers of reading and writing; the same with fields.
_ARRAYS, _FIELD_ARRAYS = 2, 5


@click.command("convert")
@grid_options
@click.argument("target", metavar="OUT", type=OUTPUT)
@click.option("--reference", type=PATH, help="The undeformed grid, for fields that compare with it.")
@packed(RunInput, "run", "max_memory", "variant", "fields", "force", "quiet")
def command(source: GridInput, target: Path, reference: Path | None, run: RunInput) -> int:
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
    from meshdeform_formats.grids import complete_for_export, format_of, read_grid, write_grid
    from meshdeform_formats.placing import existing

    kind, options, fields = format_of(target), run.variant_options, run.fields
    check_output(target, run.force, *source.files, reference)
    check_fields(fields, target, reference is not None)
    sources = [source, *([GridInput(reference)] if reference else [])]
    arrays = _ARRAYS + (_FIELD_ARRAYS if fields else 0)
    make_room(run.limit, "converting", passing(arrays), sources, existing(target.absolute().parent))
    with ProgressBar(not run.quiet, compiles=bool(fields)) as progress:
        grid = complete_for_export(source.read(), target)
        if fields:
            from meshdeform_core.quality.fields import CellFields

            progress("quality", 0, 0)
            grid = with_fields(CellFields.of(grid, None if reference is None else read_grid(reference)), fields)
        boundaries, write_boundaries = target.with_suffix(".nmf"), None
        if kind in ("plot3d", "vtk") and (grid.patches or grid.connections):
            write_boundaries = _write_boundaries(grid, boundaries, target, run.force, *source.files)
        with stage("write"):
            written = write_grid(grid, target, options)
        if write_boundaries:
            write_boundaries()
    for note in grid.notes:
        tell(f"warning: {note}")
    if target.suffix.lower() in (".vtu", ".xdmf") and options.get("boundary") != "true" and grid.patches:
        tell(
            f"warning: {target.suffix} files cannot hold the {len(grid.patches)} patches of the grid; add the outside "
            "faces with their families by --variant boundary=true"
        )
    if not run.quiet:
        beside = f"; boundaries in {boundaries}" if write_boundaries else ""
        click.echo(f"{target}: {written.label}, {counted(grid.n_blocks, 'block')}, {grid.n_nodes:,} nodes{beside}")
    return 0


def _write_boundaries(grid: Grid, path: Path, target: Path, force: bool, *inputs: Path | None) -> Callable[[], None]:
    """Refuse to replace a file with other boundaries than those of the grid; returns a function that writes it.

    Types are the families or names of patches, so that case files remain usable.
    """
    from meshdeform_formats.neutral_map import neutral_map_text, write_neutral_map

    named = tuple(dataclasses.replace(patch, bc_type=patch.family or patch.name) for patch in grid.patches)
    mapped = dataclasses.replace(grid, patches=named)
    with contextlib.suppress(OSError):
        # As after a conversion of the same grid to another format.
        if path.is_file() and path.read_bytes() == neutral_map_text(mapped).encode("utf-8"):
            return lambda: None
    try:
        check_output(path, force, *inputs)
    except FormatError as error:
        raise FormatError(
            f"{error}. {target.suffix} files cannot hold boundaries, which are therefore written next to {target} as "
            f"{path.name}, but that file has other content"
        ) from error
    return lambda: write_neutral_map(mapped, path)
