"""Entry point: commands are imported when called, errors become messages and exit codes."""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

import click

from meshdeform_core.parallel import current_ranks

from .exit_codes import EXIT_BUG, EXIT_INPUT, EXIT_INTERRUPTED
from .mpi import place, run_on_ranks

_COMMANDS = (
    "deform", "series", "quality", "info", "convert", "compare", "plot", "methods", "sample", "reproduce",
)  # fmt: skip
_ON_RANKS = ("deform", "series")


class LazyGroup(click.Group):
    """A group whose commands live one file each and are imported on demand: ``--help`` stays fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name in _COMMANDS if importlib.util.find_spec(f"{__package__}.{name}")]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = importlib.import_module(f"{__package__}.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # One-line descriptions without importing every command.
        with formatter.section("Commands"):
            formatter.write_dl([(name, _SUMMARIES[name]) for name in self.list_commands(ctx)])


_SUMMARIES = {
    "deform": "Deform a grid: read, deform, judge, write.",
    "series": "Deform a grid over time, one grid per time level.",
    "quality": "Quality report of a grid, alone or against its original.",
    "info": "Format, blocks, patches, interfaces, handedness, collapsed edges.",
    "convert": "Convert any readable grid to any writable format.",
    "compare": "Largest and rms coordinate difference of two grids.",
    "plot": "Picture of a grid plane coloured by a quality metric.",
    "methods": "The methods, their parameters and what each is good for.",
    "sample": "Write a sample case: grid and case.toml.",
    "reproduce": "Rerun the tables and figures of the paper.",
}


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
    3 cells became invalid, 130 interrupted.
    """
    if current_ranks().count > 1 and context.invoked_subcommand not in _ON_RANKS:
        raise click.UsageError(
            f"'{context.invoked_subcommand}' does not share its work among ranks; start it without mpiexec. "
            f"These do: {', '.join(_ON_RANKS)}"
        )


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # What the caller ignores (nohup) stays ignored.
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _terminate)
    here = place()
    sys.exit(run(args) if here is None else run_on_ranks(lambda: run(args), here))


def _terminate(signum: int, frame: object) -> NoReturn:
    # As an exception, so that half-written files are removed.
    raise SystemExit(128 + signum)


def run(args: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    from meshdeform_core.errors import MeshDeformError

    try:
        arguments = list(sys.argv[1:] if args is None else args)
        # Reports say how they came about: the object of the context are the arguments.
        result = cli.main(args=arguments, prog_name="meshdeform", standalone_mode=False, obj=tuple(arguments))
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except MeshDeformError as error:
        return _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.ClickException as error:
        error.show()
        return EXIT_INPUT
    except (KeyboardInterrupt, click.Abort):
        click.echo("meshdeform: interrupted; no output was left half-written", err=True)
        return EXIT_INTERRUPTED
    except (BrokenPipeError, SystemExit) as stop:
        # The reader went away (`meshdeform info grid | head`), which click turns into exit code 1: nothing more to say.
        if isinstance(stop, SystemExit) and stop.code != 1:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        # Refused by the system: no permission, a name too long, a full disk.
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except MemoryError as error:
        return _fail(f"out of memory ({error}); see --max-memory, or use a smaller grid or method")
    except Exception:
        traceback.print_exc()
        click.echo("meshdeform: internal error (a bug); please report it with the lines above", err=True)
        return EXIT_BUG


def _fail(message: str) -> int:
    click.echo(f"meshdeform: error: {message}", err=True)
    return EXIT_INPUT
