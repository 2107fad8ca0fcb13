"""``meshdeform warm-up``: compile all loops now."""

from __future__ import annotations

import time as clock

import click

from meshdeform_core.errors import CaseError


@click.command("warm-up")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def command(quiet: bool) -> int:
    """Compile all loops now instead of in later runs, as for container images and shared installations.

    \b
    Examples:
      meshdeform warm-up
      NUMBA_CACHE_DIR=/opt/meshdeform-loops meshdeform warm-up

    Otherwise, the first run that needs a loop compiles it. Compiled loops are kept with the program, or in
    NUMBA_CACHE_DIR, and are specific to the processor type on which they were compiled.
    """
    start = clock.perf_counter()
    from meshdeform_core.numerics.jit import is_cached

    from ..process.progress import ProgressBar
    from ..warm_up_runs import run_everything

    if not is_cached():
        raise CaseError("no folder for compiled loops is writable; set NUMBA_CACHE_DIR to one that is")
    with ProgressBar(not quiet) as progress:
        loops = run_everything(progress)
    if not quiet:
        click.echo(f"{loops} loops compiled, the others were already compiled; {clock.perf_counter() - start:.1f} s")
    return 0
