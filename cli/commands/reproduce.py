"""``meshdeform reproduce``: the paper's tables and figures by this program."""

from __future__ import annotations

from pathlib import Path

import click

from ..checks import check_output, make_folder
from ..options import PATH, RunInput, packed

_RESULT = "results.json"


@click.command("reproduce")
@click.argument("what")
@click.option("-o", "--output", type=PATH, required=True, help="Folder for data, tables, figures; created if missing.")
@click.option("--quick", is_flag=True, help="Small sizes: minutes instead of an hour.")
@packed(RunInput, "run", "threads", "force", "quiet")
def command(what: str, output: Path, quick: bool, run: RunInput) -> int:
    """Rerun the evaluation of Sen, De Nayer, Breuer (2017): WHAT is table2, table3, table4, table5, figB or all.

    \b
    Examples:
      meshdeform reproduce table4 -o reproduced
      meshdeform reproduce all -o reproduced --quick

    Every row is shown with the paper's own number. Sizes are the paper's unless --quick is given; in full, all takes
    about an hour on two cores.
    """
    from meshdeform_samples.reproduce import check, reproduce
    from meshdeform_samples.reproduce.report import as_markdown

    check(what)
    make_folder(output)
    check_output(output / _RESULT, run.force)

    def tell_progress(label: str, done: int, total: int) -> None:
        if not run.quiet:
            click.echo(f"meshdeform: {label} ({done} of {total})", err=True)

    results = reproduce(what, output, quick, tell_progress)
    if not run.quiet:
        click.echo(as_markdown(results), nl=False)
    return 0
