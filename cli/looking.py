"""Commands that look at grids or convert them: ``info``, ``quality``, ``compare``, ``plot`` and ``convert``."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time as clock
from pathlib import Path

import click

from meshdeform_core.memory import passing
from meshdeform_core.wording import counted

from .checks import check_output, check_reports, keep_boundaries, make_room
from .options import OUTPUT, PATH, CaseInput, FiniteNumber, GridInput, RunInput, grid_options, packed
from .process import EXIT_INVALID, ProgressBar, stage, tell

_READ, _JUDGED, _WRITTEN, _FIELDS = 1.5, 2.5, 2, 5
"""Memory in units of the coordinates: grids and buffers of reading; with verdict and totals; with buffers of writing;
what fields take besides."""
_DIFFERENT = 1
"""Exit code of grids that differ by more than the tolerance."""
MEASURES = (
    "f_skew", "scaled_jacobian", "jacobian", "relative_jacobian", "volume", "volume_ratio", "aspect_ratio",
    "growth_ratio", "non_orthogonality_deg", "skewness", "wall_normal_deviation_deg", "first_cell_height_ratio",
    "interface_kink_deg", "interface_spacing_jump", "wall_distance", "displacement",
)  # fmt: skip
"""Defined in ``meshdeform_core.quality.fields``; repeated because ``--help`` must not load compiled loops."""


@click.command("info")
@grid_options
@click.option("-v", "--verbose", is_flag=True, help="List every patch and face on its own line.")
@packed(RunInput, "run", "max_memory", "as_json")
def info_command(source: GridInput, verbose: bool, run: RunInput) -> int:
    """Show the contents of GRID: blocks, walls and other boundaries, interfaces, anomalies.

    \b
    Examples:
      meshdeform info wing.cgns
      meshdeform info airfoil.p3dfmt --boundary-file airfoil.nmf
      meshdeform info grid.vts --json

    The role of a boundary is the one that the file declares. Otherwise it is guessed from the shape of the grid (cells
    cluster towards walls and grow towards the far field) and marked with a question mark.
    """
    make_room(run.limit(), "describing", passing(_READ), [source], Path(tempfile.gettempdir()))
    grid = source.read()

    from meshdeform_formats.text import json_text

    from .facts import as_text, gather

    facts = gather(grid, str(source.path))
    click.echo(json_text(facts) if run.as_json else as_text(facts, verbose))
    return 0


@click.command("quality")
@grid_options
@click.option("--reference", type=PATH, help="The original grid: judge GRID against it.")
@packed(CaseInput, "case", "file", "displacement", "match", "tolerance", "overrides", "min_jacobian")
@packed(RunInput, "run", "reports", "as_json", "threads", "max_memory", "force", "quiet")
def quality_command(source: GridInput, reference: Path | None, case: CaseInput, run: RunInput) -> int:
    """Judge GRID, by itself or against its original.

    \b
    Examples:
      meshdeform quality deformed.cgns --reference original.cgns
      meshdeform quality deformed.cgns --reference original.cgns -c case.toml --report quality.html
      meshdeform quality grid.xyz --json

    With --reference a cell is invalid if a corner Jacobian that was positive became zero or negative (exit code 3).
    Without it, cells with such corners count as inherited. A case file (-c) defines the moving walls.
    """
    start = clock.perf_counter()

    from meshdeform_core.mending import judge_grid
    from meshdeform_formats import read_grid
    from meshdeform_formats.report.records import quality_report

    from .work import deliver

    what = case.read()
    files = [*source.files, ("reference", reference), *case.files(what)]
    check_reports(run.reports, run.force, files)
    sources = [source, *([GridInput(reference)] if reference else [])]
    make_room(run.limit(), "judging", passing(_JUDGED), sources, Path(tempfile.gettempdir()))
    with ProgressBar(not run.quiet) as progress:
        grid = source.read(what.boundary_file)
        # Boundaries that the file of the original lacks are those of the deformed grid.
        original = None if reference is None else read_grid(reference).with_patches_of(grid)
        progress("quality", 0, 0)
        assessment, notes = judge_grid(grid, original or grid, what.case)
        report = quality_report(grid, assessment, notes, str(reference) if reference else None, original)
    run.warn(report["warnings"])
    # With --json the text would be redundant.
    deliver(report, dataclasses.replace(run, quiet=run.quiet or run.as_json), start, files)
    return 0 if report["valid"] else EXIT_INVALID


@click.command("compare")
@click.argument("first", metavar="A", type=PATH)
@click.argument("second", metavar="B", type=PATH)
@click.option("--tolerance", type=FiniteNumber(min=0.0), help="Exit 1 if any coordinate differs by more.")
@packed(RunInput, "run", "max_memory", "as_json")
def compare_command(first: Path, second: Path, tolerance: float | None, run: RunInput) -> int:
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
    make_room(run.limit(), "comparing", passing(_READ), sources, Path(tempfile.gettempdir()))
    difference = compare_points(read_grid(first), read_grid(second))
    if run.as_json:
        click.echo(json.dumps(dataclasses.asdict(difference), indent=2))
    else:
        click.echo(f"largest {difference.largest:.6e} at {difference.where}")
        nodes = f"{difference.differing_nodes:,} of {difference.nodes:,} nodes differ"
        click.echo(f"rms     {difference.rms:.6e}, {nodes}")
        for block in difference.blocks:
            click.echo(f"  {block.name}: largest {block.largest:.3e}, rms {block.rms:.3e}")
    return _DIFFERENT if tolerance is not None and difference.largest > tolerance else 0


@click.command("plot")
@grid_options
@click.option("-o", "--output", type=PATH, required=True, help="Picture, .png .svg or .pdf.")
@click.option("--reference", type=PATH, help="The undeformed grid, for measures that compare with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help=f"Colour by this: {', '.join(MEASURES)}.")  # fmt: skip
@click.option("--plane", metavar="AXIS=N", help="Plane of nodes (k=1, j=mid) or cut in space (z=0.25).")
@click.option("--select", multiple=True, metavar="PATTERN",
              help="Patches or block faces (repeatable).")  # fmt: skip
@click.option("--view", default="auto", show_default=True, metavar="auto|x|y|z|iso|X,Y,Z",
              help="Look along an axis, or from a direction.")  # fmt: skip
@click.option("--zoom", metavar="worst|walls|L,R,B,T", help="Close-up, or window: left, right, bottom, top.")
@click.option("--range", "limits", metavar="LOW,HIGH", help="Ends of the colours (default: of the values).")
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--title", default=None, help="Default: the file's name.")
@packed(RunInput, "run", "force", "quiet")
def plot_command(
    source: GridInput, output: Path, reference: Path | None, title: str | None, run: RunInput, **options: object
) -> int:
    """Draw GRID coloured by a measure of its cells.

    \b
    Examples:
      meshdeform plot wing.cgns -o wing.png
      meshdeform plot bent.cgns -o worst.png --reference wing.cgns --zoom worst
      meshdeform plot bent.cgns -o cut.pdf --plane y=0.5 --zoom walls --metric scaled_jacobian
      meshdeform plot bent.cgns -o moved.png --reference wing.cgns --select wing --metric displacement
      meshdeform plot airfoil.p2dfmt -o nose.svg --zoom=-0.1,0.3,-0.2,0.2

    The default view depends on the grid: plane and extruded grids are seen from above, others as walls in space and a
    cut, with a close-up of walls that are small relative to the grid. Invalid cells have a colour of their own: with
    --reference those that became invalid, otherwise all.
    """
    from meshdeform_formats import read_grid
    from meshdeform_formats.files import shown
    from meshdeform_formats.picture.overview import PlotOptions, picture
    from meshdeform_formats.picture.page import check_picture_path, save_page
    from meshdeform_formats.picture.subject import Subject

    request = PlotOptions(**options, lead="--")  # type: ignore[arg-type]
    check_picture_path(output)
    check_output(output, run.force, [*source.files, ("reference", reference)])
    name = shown(Path(source.path.name)) if title is None else title
    with ProgressBar(not run.quiet):
        subject = Subject.of(source.read(), None if reference is None else read_grid(reference))
        save_page(picture(subject, request, name), output)
    return 0


@click.command("convert")
@grid_options
@click.argument("target", metavar="OUT", type=OUTPUT)
@click.option("--reference", type=PATH, help="The undeformed grid, for fields that compare with it.")
@packed(RunInput, "run", "max_memory", "variant", "fields", "force", "quiet")
def convert_command(source: GridInput, target: Path, reference: Path | None, run: RunInput) -> int:
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
    from meshdeform_formats.inputs import existing

    format_of(target)
    check_output(target, run.force, [*source.files, ("reference", reference)])
    check_fields(run.fields, target, reference is not None)
    sources = [source, *([GridInput(reference)] if reference else [])]
    arrays = passing(_WRITTEN + (_FIELDS if run.fields else 0))
    make_room(run.limit(), "converting", arrays, sources, existing(target.absolute().parent))
    with ProgressBar(not run.quiet, compiles=bool(run.fields)) as progress:
        grid = complete_for_export(source.read(), target, run.variant_options)
        if run.fields:
            from meshdeform_core.quality.fields import CellFields

            progress("quality", 0, 0)
            grid = with_fields(CellFields.of(grid, None if reference is None else read_grid(reference)), run.fields)
        write_boundaries = keep_boundaries(grid, target, run.force, source.files)
        with stage("write"):
            written = write_grid(grid, target, run.variant_options)
        boundaries = write_boundaries()
    for note in grid.notes:
        tell(f"warning: {note}")
    if not run.quiet:
        beside = f"; boundaries in {boundaries}" if boundaries else ""
        click.echo(f"{target}: {written.label}, {counted(grid.n_blocks, 'block')}, {grid.n_nodes:,} nodes{beside}")
    return 0
