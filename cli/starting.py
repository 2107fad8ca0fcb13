"""Commands around the use of the program: ``init``, ``sample``, ``methods``, ``schema``, ``reproduce``, ``warm-up``."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import textwrap
import time as clock
from pathlib import Path

import click

from meshdeform_core.errors import CaseError
from meshdeform_core.wording import counted

from .checks import check_output, make_folder
from .options import PATH, GridInput, RunInput, grid_options, packed


@click.command("init")
@grid_options
@click.option("-o", "--output", type=PATH, help="Case file to write (default: print it).")
@click.option("--table", type=PATH, help="Displacement table for the wall that it fits.")
@packed(RunInput, "run", "force")
def init_command(source: GridInput, output: Path | None, table: Path | None, run: RunInput) -> int:
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
    from meshdeform_core.grid.faces import find_outside
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_formats.case.template import case_template, fitted_table
    from meshdeform_formats.files import replacing, shown

    if output is not None:
        check_output(output, run.force, [*source.files, ("table", table)])
    grid = source.read()
    map_file = _from_case(source.boundary_file, output) if source.boundary_file else None
    if map_file is not None and shown(Path(map_file)) != map_file:
        raise CaseError(f"{shown(Path(map_file))}: its name is not UTF-8, so a case file cannot refer to it; rename it")
    topology = find_topology(grid)
    fitted = None if table is None else fitted_table(grid, topology, table, _from_case(table, output))
    text = case_template(grid, find_outside(grid, topology), shown(source.path), map_file, fitted)
    if output is None:
        click.echo(text, nl=False)
        return 0
    with replacing(output) as partial:
        partial.write_text(text, encoding="utf-8")
    first = "fill in the motion" if fitted is None else "check the boundaries"
    click.echo(f"{output}: {first}, then: meshdeform deform {source.path} -c {output} --dry-run")
    return 0


def _from_case(file: Path, case: Path | None) -> str:
    """A file name for a case file: relative to the case's folder, unless given as an absolute path."""
    return str(file) if file.is_absolute() else os.path.relpath(file, case.parent if case else Path())


@click.command("sample")
@click.argument("name", required=False)
@click.option("-o", "--output", type=PATH, help="Folder for grid and case.toml; created if missing.")
@click.option("--size", help="Size of the grid: a number, whose meaning depends on the sample, or a name like small.")
@packed(RunInput, "run", "force", "quiet")
def sample_command(name: str | None, output: Path | None, size: str | None, run: RunInput) -> int:
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
    from meshdeform_formats.grids import write_grid
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
    target, (grid, tables) = output / "grid.cgns", generate(name, size)
    written = [file for file in folder(name).iterdir() if file.name.endswith((".toml", ".md"))]
    texts = {file.name: file.read_text(encoding="utf-8") for file in written}
    make_folder(output)
    for file in (target.name, *tables, *texts):
        check_output(output / file, run.force)
    write_grid(grid, target)
    for file, table in tables.items():
        write_displacement(output / file, table)
    for file, text in texts.items():
        with replacing(output / file) as partial:
            partial.write_text(text, encoding="utf-8")
    if not run.quiet:
        blocks = counted(grid.n_blocks, "block")
        click.echo(f"{target}: {blocks}, {grid.n_nodes:,} nodes; case in {output / 'case.toml'}")
    return 0


@click.command("methods")
@click.argument("name", required=False)
def methods_command(name: str | None) -> int:
    """List the methods, or explain NAME: parameters, defaults, strengths and limits.

    \b
    Examples:
      meshdeform methods
      meshdeform methods idw-tfi
    """
    from meshdeform_core.methods import ALIASES, CATALOGUE, declared, entry_of

    if name is None:
        for key, entry in CATALOGUE.items():
            alias = next((f" (= {a})" for a, full in ALIASES.items() if full == key), "")
            click.echo(f"{key}{alias}\n    {entry.summary}")
        click.echo("\nmeshdeform methods NAME explains one of them.")
        return 0
    entry = entry_of(name)
    click.echo(f"{ALIASES.get(name, name)}: {entry.summary}\n\n{_prose(entry.advice)}")
    for part in entry.parts:
        # Its section of the case file: a description, then every option with default, meaning and reason.
        summary = (part.__doc__ or "").partition("Attributes\n")[0].strip()
        lines = [f"\n[method.{part.__name__.lower()}]", *(_prose(text) + "\n" for text in summary.split("\n\n"))]
        options = list(declared(part).values())
        for option, before in zip(options, [None, *options[:-1]], strict=True):
            lines.append(f"  {option.name} = {json.dumps(option.default)}")
            if before is None or before.meaning != option.meaning:
                alike = ", ".join(other.name for other in options if other.meaning == option.meaning)
                meaning = f"{alike}: {option.meaning}" if alike != option.name else option.meaning
                lines.append(_prose(meaning, "      "))
            lines.append(_prose(f"default: {option.why}", "      "))
        click.echo("\n".join(lines))
    return 0


def _prose(text: str, indent: str = "") -> str:
    """Plain text without markup, wrapped."""
    plain = " ".join(text.replace("``", "").split())
    return textwrap.fill(plain, 100, initial_indent=indent, subsequent_indent=indent)


@click.command("schema")
@click.argument("what", type=click.Choice(["case"]))
def schema_command(what: str) -> int:
    """Print the JSON schema of a case file.

    \b
    Example:
      meshdeform schema case > case.schema.json

    TOML-aware editors complete and check a case whose first line is `#:schema ./case.schema.json`.
    """
    from meshdeform_formats.case.reader import case_schema

    click.echo(json.dumps(case_schema(), indent=2, ensure_ascii=False))
    return 0


@click.command("reproduce")
@click.argument("what", metavar="WHAT", type=click.Choice(("table2", "table3", "table4", "table5", "figB", "all")))
@click.option("-o", "--output", type=PATH, required=True, help="Folder for data, tables, figures; created if missing.")
@click.option("--quick", is_flag=True, help="Small sizes: minutes instead of an hour.")
@packed(RunInput, "run", "threads", "force", "quiet")
def reproduce_command(what: str, output: Path, quick: bool, run: RunInput) -> int:
    """Rerun the evaluation of Sen, De Nayer, Breuer (2017): WHAT is table2, table3, table4, table5, figB or all.

    \b
    Examples:
      meshdeform reproduce table4 -o reproduced
      meshdeform reproduce all -o reproduced --quick

    Every row is shown with the paper's own number. Sizes are the paper's unless --quick is given; in full, all takes
    about an hour on two cores.
    """
    from meshdeform_samples.reproduce import reproduce
    from meshdeform_samples.reproduce.report import as_markdown

    make_folder(output)
    check_output(output / "results.json", run.force)

    def tell_progress(label: str, done: int, total: int) -> None:
        if not run.quiet:
            click.echo(f"meshdeform: {label} ({done} of {total})", err=True)

    results = reproduce(what, output, quick, tell_progress)
    if not run.quiet:
        click.echo(as_markdown(results), nl=False)
    return 0


@click.command("warm-up")
@click.option("--cpu", metavar="LEVEL", help="Processors to compile for: x86-64, x86-64-v2, x86-64-v3, x86-64-v4.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def warm_up_command(cpu: str | None, quiet: bool) -> int:
    """Compile all loops now instead of in later runs, as for container images and shared installations.

    \b
    Examples:
      meshdeform warm-up
      NUMBA_CACHE_DIR=/opt/meshdeform-loops meshdeform warm-up
      meshdeform warm-up --cpu x86-64-v3

    Otherwise, the first run that needs a loop compiles it. Compiled loops are kept with the program, or in
    NUMBA_CACHE_DIR, and are specific to the processor type on which they were compiled. With --cpu they suit all
    processors of that level, and are found by runs whose environment has MESHDEFORM_CPU=LEVEL.
    """
    start = clock.perf_counter()
    if cpu:
        os.environ["MESHDEFORM_CPU"] = cpu
    # The compiler is imported here, with the processor that it is for.
    from meshdeform_core.numerics.jit import compile_all, compile_clock

    if not compile_clock.cached:
        raise CaseError("no folder for compiled loops is writable; set NUMBA_CACHE_DIR to one that is")
    for package in ("meshdeform_core", "meshdeform_formats"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
            importlib.import_module(module.name)
    loops = compile_all()
    if not quiet:
        taken = clock.perf_counter() - start
        click.echo(f"{counted(loops, 'loop')} compiled, the others were already compiled; {taken:.1f} s")
    return 0
