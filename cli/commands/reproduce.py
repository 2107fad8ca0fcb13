"""``meshdeform reproduce``: the paper's tables and figures by this program."""

from __future__ import annotations

from pathlib import Path

import click

from ..options import PATH, force_option, quiet_option, threads_option
from ..outputs import check_output, make_folder

_RESULT = "results.json"


@click.command("reproduce")
@click.argument("what")
@click.option("-o", "--output", type=PATH, required=True, help="Folder for data, tables, figures; created if missing.")
@click.option("--quick", is_flag=True, help="Small sizes: minutes instead of an hour.")
@threads_option
@force_option
@quiet_option
def command(what: str, output: Path, quick: bool, force: bool, quiet: bool) -> int:
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
    check_output(output / _RESULT, force)

    def tell_progress(label: str, done: int, total: int) -> None:
        if not quiet:
            click.echo(f"meshdeform: {label} ({done} of {total})", err=True)

    results = reproduce(what, output, quick, tell_progress)
    if not quiet:
        click.echo(as_markdown(results), nl=False)
    return 0
