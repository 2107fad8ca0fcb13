"""Entry point: commands are imported when called, errors become messages and exit codes."""

from __future__ import annotations

import errno
import gc
import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

import click

from meshdeform_core import interruption
from meshdeform_core.errors import suggestion
from meshdeform_core.parallel import ONE_PROCESS, Ranks, set_sharing

from .process import (
    EXIT_BUG,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    Handler,
    Start,
    drop,
    end_of,
    flushed,
    open_streams,
    place,
    run_on_ranks,
    tell,
)

_ON_RANKS = ("deform", "series")
_OBJECTS = 200_000
"""New objects in containers that make the collector look for cycles among them."""
LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_OF_STREAMS = (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EFBIG, errno.EBADF)


_COMMANDS = {
    "deform": ("running", "Deform a grid: read, deform, judge, write."),
    "series": ("running", "Deform a grid over time, one grid per time level."),
    "repair": ("running", "Make a grid valid that another program deformed."),
    "quality": ("looking", "Quality report of a grid, by itself or against its original."),
    "info": ("looking", "Contents of a grid: blocks, walls, interfaces."),
    "init": ("starting", "Create a case file with every boundary of a grid."),
    "convert": ("looking", "Convert any readable grid to any writable format."),
    "compare": ("looking", "Largest and rms coordinate difference of two grids."),
    "plot": ("looking", "Picture of a grid coloured by a measure of its cells."),
    "methods": ("starting", "The methods, their parameters, strengths and limits."),
    "sample": ("starting", "Write a sample case: grid and case.toml."),
    "schema": ("starting", "JSON schema of case files."),
    "reproduce": ("starting", "Rerun the tables and figures of the paper."),
    "warm-up": ("starting", "Compile all loops now (container images)."),
}
"""Commands with their modules and one-line descriptions, as importing all for ``--help`` would take long."""


class LazyGroup(click.Group):
    """A group whose commands are imported on demand: ``warm_up_command`` of its module is ``warm-up``."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name.startswith("-"):
            return None
        if cmd_name not in _COMMANDS:
            raise click.UsageError(f"no such command {cmd_name!r}{suggestion(cmd_name, _COMMANDS)}", ctx)
        module = importlib.import_module(f"{__package__}.{_COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, f"{cmd_name.replace('-', '_')}_command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="meshdeform")
@click.pass_context
def cli(context: click.Context) -> None:
    """Deform block-structured grids and judge the result.

    \b
    Examples:
      meshdeform sample splitter-plate -o case
      meshdeform deform case/grid.cgns -c case/case.toml -o case/deformed.cgns --report case/report.json
      meshdeform info case/grid.cgns
      meshdeform quality case/deformed.cgns --reference case/grid.cgns

    Results go to stdout, messages to stderr. Exit codes: 0 done and valid, 1 internal error, 2 bad usage or input,
    3 cells became invalid, 130, 143 or 129 ended by SIGINT, SIGTERM or SIGHUP.
    """
    if context.obj.ranks.count > 1 and context.invoked_subcommand not in _ON_RANKS:
        raise click.UsageError(
            f"'{context.invoked_subcommand}' cannot run on several ranks; start it without mpiexec. "
            f"Commands that can: {', '.join(_ON_RANKS)}"
        )


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    # The 140,000 objects of a start remain; by default the collector visits them over and over, a seventh of its time.
    gc.set_threshold(_OBJECTS)
    open_streams()
    handler = Handler()
    here = place()
    code = run(args) if here is None else run_on_ranks(lambda ranks: run(args, ranks), here)
    handler.finish()
    stopped = interruption.requested()
    flushed(sys.stderr)
    # The interpreter would look for cycles in all that was imported once more; the system frees the memory anyway.
    gc.freeze()
    sys.exit(code if stopped is None else 128 + stopped)


def run(args: Sequence[str] | None = None, ranks: Ranks = ONE_PROCESS) -> int:
    """Run the command line; returns the exit code."""
    try:
        code = _invoke(args, ranks)
    except BaseException as error:
        # The exception of a signal, or one into which a library converted it.
        if interruption.requested() is None:
            if not isinstance(error, Exception):
                raise
            traceback.print_exc()
            tell("internal error (a bug); please report it with the lines above")
            code = EXIT_BUG
    finally:
        interruption.clean_up()
    unwritten = flushed(sys.stdout)
    if (stopped := interruption.requested()) is not None:
        tell(end_of(stopped))
        return 128 + stopped
    # With another exit code the failure may already have been reported.
    return _fail(f"cannot write to stdout: {unwritten}") if unwritten and code == 0 else code


def _invoke(args: Sequence[str] | None, ranks: Ranks) -> int:
    """Call the command; errors in the input or from the system become a message and exit code 2."""
    from meshdeform_core.errors import CaseError, MeshDeformError

    try:
        # Check and set environment variables, and check the current folder, on which imports of libraries may fail.
        try:
            os.getcwd()
        except FileNotFoundError:
            raise CaseError("the current folder does not exist any more; change to another one") from None

        # Pictures are drawn into files, whatever backend the user has set for matplotlib.
        os.environ["MPLBACKEND"] = "agg"
        # The linear algebra libraries of numpy and scipy read these when they are loaded. Our loops call them from all
        # threads, mostly with small matrices; threads of their own would busy-wait.
        os.environ.update(dict.fromkeys(LIBRARIES, "1"))
        # The HDF5 library crashes on an unknown driver, and only the default one is of use here.
        os.environ.pop("HDF5_DRIVER", None)
        threads = os.environ.get("NUMBA_NUM_THREADS")
        if threads is not None and not (threads.isdecimal() and int(threads) > 0):
            raise CaseError(
                f"NUMBA_NUM_THREADS={threads}: expected a whole number >= 1; correct or unset this variable"
            )
        arguments = tuple(sys.argv[1:] if args is None else args)
        set_sharing(threads=ranks.cores)
        result = cli.main(args=arguments, prog_name="meshdeform", standalone_mode=False, obj=Start(arguments, ranks))
        return result if isinstance(result, int) else 0
    except MeshDeformError as error:
        return _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.ClickException as error:
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else ""
        return _fail(error.format_message().removesuffix(".") + (f" (see {where} --help)" if where else ""))
    except (KeyboardInterrupt, click.Abort) as stop:
        if isinstance(stop.__cause__, EOFError):
            # click takes it for the end of what a user types; here it is an error of a reader.
            raise stop.__cause__ from None
        tell("interrupted; no output was left half-written")
        return EXIT_INTERRUPTED
    except (BrokenPipeError, SystemExit) as stop:
        # The reader has closed the pipe (`meshdeform info grid | head`), for which click exits with 1; no error.
        if isinstance(stop, SystemExit) and stop.code != 1:
            raise
        drop(sys.stdout)
        return 0
    except OSError as error:
        # From the operating system: no permission, a name too long, a full disk; without a file it is of stdout.
        where = error.filename or ("cannot write to stdout" if error.errno in _OF_STREAMS else "")
        return _fail(f"{where}: {error.strerror}" if where else str(error))
    except MemoryError as error:
        return _fail(f"out of memory ({error}); see --max-memory, or use a smaller grid or method")


def _fail(message: str) -> int:
    tell(f"error: {message}")
    return EXIT_INPUT
