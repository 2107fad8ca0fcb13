"""Options that several commands share, packed into records, with the checks that need no grid."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.memory import (
    PICTURE_BYTES,
    SWEPT_BYTES,
    VELOCITY_BYTES,
    MemoryLimit,
    machine_memory,
    parse_memory,
)
from meshdeform_core.parallel import set_threads

from .process.messages import Warnings

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_formats.case import CaseFile

Command = Callable[..., Any]
Option = Callable[[Command], Command]

PATH = click.Path(path_type=Path)
# Environment variables that the linear algebra libraries of numpy and scipy read once, when they are loaded.
LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def packed(record: type, name: str, *options: Option) -> Option:
    """A decorator that adds options to a command, which gets those that are fields of a record as one argument."""
    own = [field.name for field in dataclasses.fields(record)]

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def call(**given: Any) -> Any:
            found = {key: given.pop(key) for key in own if key in given}
            return command(**{name: record(**found)}, **given)

        decorated: Command = call
        for option in reversed(options):
            decorated = option(decorated)
        return decorated

    return decorate


class OutputPath(click.Path):
    """The path of a grid that is written; a folder is an OpenFOAM case, of which this is the ``.foam`` file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from meshdeform_formats.openfoam.case import output_path

        super().convert(value, param, ctx)
        return output_path(str(value))


OUTPUT = OutputPath(path_type=Path)


class FiniteNumber(click.FloatRange):
    """A finite number: nan and inf would pass click's range checks."""

    def _describe_range(self) -> str:
        # Without limits click would describe the range as x<=None.
        return "" if self.min is None and self.max is None else super()._describe_range()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


def _use_threads(context: click.Context, _: click.Parameter, count: int | None) -> None:
    """Apply ``--threads`` to our loops, and run linear algebra in one thread, before numpy is imported.

    Our loops call it from all threads, mostly with small matrices; additional threads of the libraries would busy-wait.
    """
    if not context.resilient_parsing:
        set_threads(count)
        os.environ.update(dict.fromkeys(LIBRARIES, "1"))


def _steps(context: click.Context, option: click.Parameter, text: str | None) -> int | str | None:
    if text is None or text == "auto":
        return text
    if not text.isascii() or not text.isdigit() or int(text) == 0:
        raise CaseError(f'--steps {text!r}: expected a whole number >= 1 or "auto"')
    return int(text)


def parse_pairs(pairs: tuple[str, ...], option: str) -> dict[str, str]:
    """``("encoding=ascii", ...)`` as a dictionary."""
    options = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise FormatError(f"{option} {pair!r}: expected KEY=VALUE, like encoding=ascii")
        options[key.strip()] = value.strip()
    return options


force_option = click.option("--force", is_flag=True, help="Overwrite an existing output (never the input).")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print errors and warnings only.")
threads_option = click.option(
    "--threads", type=click.IntRange(min=1), callback=_use_threads, expose_value=False,
    help="Use at most this many threads.",
)  # fmt: skip
memory_option = click.option(
    "--max-memory", metavar="SIZE",
    help="Memory limit, like 2GiB. Larger grids are kept in temporary files; what does not fit even so is refused.",
)  # fmt: skip
variant_option = click.option(
    "--variant", metavar="KEY=VALUE", multiple=True,
    help="How to write the output. plot3d: encoding=ascii|binary|fortran byte_order=little|big "
    "precision=float32|float64 markers=4|8 records=block|array|plane multiblock=true|false iblank=true|false "
    "dimension=2|3; vtk: encoding=ascii, or binary (.vtk), appended (.vts, .vtm); cgns: precision; "
    "openfoam: encoding=binary|ascii thickness=LENGTH (2-D grids); .msh: encoding=binary|ascii; .vtu and .xdmf: "
    "boundary=true|false (repeatable).",
)  # fmt: skip
field_option = click.option(
    "--field", "fields", metavar="NAME", multiple=True,
    help="Write this into VTK and CGNS files too: displacement, invalid, a measure of `meshdeform plot`, or all "
    "(repeatable).",
)  # fmt: skip
report_option = click.option(
    "--report", "reports", type=PATH, multiple=True,
    help="Report file; the suffix selects .json .txt or .html, - is JSON to stdout (repeatable).",
)  # fmt: skip
min_jacobian_option = click.option(
    "--min-jacobian", type=float, metavar="R", help="Count a cell as invalid below R times its undeformed Jacobian."
)


def steps_option(what: str) -> Option:
    """``--steps`` of a command that imposes ``what``."""
    text = f"Impose {what} in N steps; by default in as many as needed."
    return click.option("--steps", metavar="N|auto", callback=_steps, help=text)


@dataclass(frozen=True)
class GridInput:
    """A grid file with the options for reading it."""

    path: Path
    boundary_file: Path | None = None
    read_as: tuple[str, ...] = ()

    def read(self, boundary_file: Path | None = None) -> Grid:
        """The grid; ``boundary_file`` is that of the case, used if the command line names none."""
        from meshdeform_formats.files import invalid_path
        from meshdeform_formats.grids import read_grid_with_boundaries

        from .process.progress import stage

        options = parse_pairs(self.read_as, "--read-as")
        if not self.path.exists() and (beside := invalid_path(self.path)).exists():
            raise FormatError(f"{self.path} does not exist; {beside} is the invalid grid of a run")
        with stage("read"):
            return read_grid_with_boundaries(self.path, self.boundary_file or boundary_file, options)

    @property
    def files(self) -> tuple[Path | None, ...]:
        """Files that no output may overwrite."""
        return self.path, self.boundary_file

    @property
    def roles(self) -> list[tuple[str, Path | None]]:
        """The files of the input with their roles, for the report."""
        return [("grid", self.path), ("boundary file", self.boundary_file)]


grid_options = packed(
    GridInput,
    "source",
    click.argument("path", metavar="GRID", type=PATH),
    click.option("--boundary-file", type=PATH, help="Neutral map file (.nmf) with the boundaries."),
    click.option(
        "--read-as", metavar="KEY=VALUE", multiple=True,
        help="How to read an ambiguous Plot3D file; keys as for --variant (repeatable).",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class CaseInput:
    """The case as given on the command line."""

    file: Path | None
    displacement: Path | None = None
    match: str | None = None
    tolerance: float | None = None
    overrides: tuple[str, ...] = ()
    min_jacobian: float | None = None
    method: str | None = None
    repair: str | None = None
    times: str | None = None

    def read(self) -> CaseFile:
        """The case file with the additions of the command line."""
        from meshdeform_formats.case import read_case

        matching, overrides = None, self.overrides
        if self.match is not None or self.tolerance is not None:
            from meshdeform_core.boundary.tables import AUTOMATIC, Matching

            if self.displacement is None:
                raise click.UsageError("--match and --tolerance belong to --displacement; in a case they are keys.")
            matching = Matching(self.match or AUTOMATIC, self.tolerance, partial=True)
        if self.repair is not None:
            overrides += (f'repair.mode="{self.repair}"',)
        if self.min_jacobian is not None:
            overrides += (f"repair.min_jacobian={self.min_jacobian!r}",)
        return read_case(self.file, overrides, self.method, self.displacement, self.times, matching)

    def roles(self, read: CaseFile) -> list[tuple[str, Path | None]]:
        """The files of the input, and those named in the case ``read``, with their roles, for the report."""
        return [("case", self.file), *(("displacement", path) for path in read.files)]

    @property
    def empty(self) -> bool:
        """Whether it says nothing about a motion."""
        given = self.file, self.displacement, self.repair, self.min_jacobian
        return all(each is None for each in given) and not self.overrides

    @property
    def files(self) -> tuple[Path | None, ...]:
        """Files that no output may overwrite."""
        return self.file, self.displacement


case_option = click.option("-c", "--case", "file", type=PATH, help="Case file (TOML).")
_WALL_OPTIONS = (
    case_option,
    click.option("-d", "--displacement", type=PATH, help="Surface displacement table."),
    click.option(
        "--match", metavar="HOW", help="For -d: exact, nearest or interpolate (default: what fits the table)."
    ),
    click.option("--tolerance", type=FiniteNumber(), metavar="T", help="For -d: largest distance of a match."),
    click.option(
        "-s", "--set", "overrides", metavar="KEY=VALUE", multiple=True,
        help="Override a key of the case, like method.idw.alpha=0.3 (repeatable).",
    ),
    min_jacobian_option,
)  # fmt: skip
judged_case_options = packed(CaseInput, "case", *_WALL_OPTIONS)
"""Of commands that judge but do not deform: which walls move, and which cells count as invalid."""
case_options = packed(
    CaseInput,
    "case",
    *_WALL_OPTIONS,
    click.option(
        "-m", "--method", metavar="NAME",
        help="tfi, idw, rbf or a hybrid like idw-tfi (the default).",
    ),
    click.option(
        "--repair", type=click.Choice(["auto", "off", "polish"]),
        help="auto (default): repair invalid and weak cells; off: never; polish: improve the worst cells of any grid.",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class RunInput:
    """Limits, outputs and verbosity of a command that makes grids."""

    reports: tuple[Path, ...]
    as_json: bool
    max_memory: str | None
    variant: tuple[str, ...]
    fields: tuple[str, ...]
    dry_run: bool
    force: bool
    allow_invalid: bool
    strict: bool
    quiet: bool
    verbose: bool

    @functools.cached_property
    def warnings(self) -> Warnings:
        """The printer of warnings."""
        return Warnings(self.strict)

    @property
    def memory(self) -> MemoryLimit:
        """The limit of memory, less what pictures of a report take."""
        limit = machine_memory() if self.max_memory is None else parse_memory(self.max_memory, "--max-memory")
        drawn = any(path.suffix.lower() == ".html" for path in self.reports)
        return limit.after(PICTURE_BYTES, "pictures of the report") if drawn else limit

    @property
    def variant_options(self) -> dict[str, str]:
        """How to write the output, by key."""
        return parse_pairs(self.variant, "--variant")


run_options = packed(
    RunInput,
    "run",
    report_option,
    click.option("--json", "as_json", is_flag=True, help="Print the report as JSON; everything else goes to stderr."),
    threads_option,
    memory_option,
    variant_option,
    field_option,
    click.option("--dry-run", is_flag=True, help="Show what would be done; write nothing."),
    force_option,
    click.option("--allow-invalid", is_flag=True, help="Write the grid and exit 0 even if cells became invalid."),
    click.option("--strict", is_flag=True, help="Treat warnings as errors: exit code 2, no grid is written."),
    quiet_option,
    click.option("-v", "--verbose", is_flag=True, help="Show stages and their times on stderr."),
)


@dataclass(frozen=True)
class SeriesInput:
    """Output folder, times, mode and format of the levels."""

    output: Path
    times: str | None
    origin: str
    steps: int | str | None
    velocity: str
    suffix: str | None
    resume: bool

    @property
    def velocity_bytes(self) -> int:
        """Bytes per node that the velocities take in memory."""
        return VELOCITY_BYTES * (self.velocity != "none") + SWEPT_BYTES * (self.velocity == "swept")
