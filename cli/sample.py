"""``meshdeform sample``: a case to start from."""

from __future__ import annotations

from pathlib import Path

import click

from meshdeform_core.errors import CaseError

from .options import PATH, check_output, force_option, parse_pairs, variant_option


@click.command("sample")
@click.argument("name", required=False)
@click.option("-o", "--output", type=PATH, help="Folder for grid, case.toml and README.md; made if missing.")
@click.option("--size", type=int, help="Size of the grid; what it counts depends on the sample.")
@click.option("--suffix", default=".cgns", show_default=True, help="Format of the grid, by suffix.")
@variant_option
@force_option
def command(
    name: str | None, output: Path | None, size: int | None, suffix: str, variant: tuple[str, ...], force: bool
) -> int:
    """Write the sample case NAME into a folder; without NAME list what there is.

    \b
    Examples:
      meshdeform sample
      meshdeform sample splitter-plate -o case --size 16
      meshdeform deform case/grid.cgns -c case/case.toml -o case/deformed.cgns
    """
    from meshdeform_formats.grids import format_of, write_grid
    from meshdeform_samples import SAMPLES, folder, load

    if name is None:
        for key in SAMPLES:
            module = load(key)
            title = (module.__doc__ or "").splitlines()[0]
            click.echo(f"{key}\n    {title}\n    --size: {module.SIZE_HELP}; default {module.DEFAULT_SIZE}")
        return 0
    if name not in SAMPLES:
        raise CaseError(f"sample {name!r} is unknown; known are {', '.join(SAMPLES)}")
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    target = output / f"grid{suffix if suffix.startswith('.') else '.' + suffix}"
    format_of(target)
    if output.exists() and not output.is_dir():
        raise CaseError(f"{output} is a file; expected a folder")
    output.mkdir(parents=True, exist_ok=True)
    texts = {output / file: (folder(name) / file).read_text(encoding="utf-8") for file in ("case.toml", "README.md")}
    for path in (target, *texts):
        check_output(path, force)
    module = load(name)
    try:
        grid = module.generate(module.DEFAULT_SIZE if size is None else size)
    except ValueError as error:
        raise CaseError(f"sample {name}: {error}") from error
    write_grid(grid, target, parse_pairs(variant, "--variant"))
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    click.echo(f"{target}: {grid.n_blocks} blocks, {grid.n_nodes:,} nodes; case in {output / 'case.toml'}")
    return 0
