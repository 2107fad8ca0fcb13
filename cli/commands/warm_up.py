"""``meshdeform warm-up``: compile all loops now."""

from __future__ import annotations

import importlib
import os
import pkgutil
import time as clock

import click

from meshdeform_core.errors import CaseError
from meshdeform_core.wording import counted


@click.command("warm-up")
@click.option("--cpu", metavar="LEVEL", help="Processors to compile for: x86-64, x86-64-v2, x86-64-v3, x86-64-v4.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def command(cpu: str | None, quiet: bool) -> int:
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
    from meshdeform_core.numerics.jit import compile_all, is_cached

    if not is_cached():
        raise CaseError("no folder for compiled loops is writable; set NUMBA_CACHE_DIR to one that is")
    for package in ("meshdeform_core", "meshdeform_formats"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
            importlib.import_module(module.name)
    loops = compile_all()
    if not quiet:
        taken = clock.perf_counter() - start
        click.echo(f"{counted(loops, 'loop')} compiled, the others were already compiled; {taken:.1f} s")
    return 0
