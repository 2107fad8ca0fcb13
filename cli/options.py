"""Options as fields of records, of which commands take all or some, with the checks that need no grid."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.memory import PICTURE_BYTES, MemoryLimit, machine_memory, parse_memory
from meshdeform_core.parallel import ONE_PROCESS, Ranks, set_sharing
from meshdeform_core.wording import first_of_each_kind, kind_of

from .process import stage, tell

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_formats.case import CaseFile
    from meshdeform_formats.grids import Layout

Command = Callable[..., Any]
Files = Sequence[tuple[str, Path | None]]
"""Input files with their roles, for reports; no output may overwrite them."""

PATH = click.Path(path_type=Path)


def given(*names: str, **settings: Any) -> Any:
    """A field of a record that :func:`packed` makes an option, or an argument without ``names``, of commands."""
    default = () if settings.get("multiple") else False if settings.get("is_flag") else settings.get("default")
    return dataclasses.field(default=default, metadata={"names": names, "settings": settings})


def packed(record: type, name: str, *chosen: str, without: str = "") -> Callable[[Command], Command]:
    """A decorator that adds the fields of a record, all but one or those ``chosen``, to a command, which gets the
    record."""
    every = [field for field in dataclasses.fields(record) if field.metadata and field.name != without]
    fields = [field for field in every if field.name in (chosen or (field.name,))]

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def call(**values: Any) -> Any:
            found = {field.name: values.pop(field.name) for field in fields}
            return command(**{name: record(**found)}, **values)

        decorated: Command = call
        for field in reversed(fields):
            names, settings = field.metadata["names"], field.metadata["settings"]
            decorated = (click.option if names else click.argument)(*names, field.name, **settings)(decorated)
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


def _use_threads(context: click.Context, _: click.Parameter, count: int | None) -> int | None:
    if count and not context.resilient_parsing:
        set_sharing(threads=count)
    return count


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


@dataclass(frozen=True)
class GridInput:
    """A grid file with the options for reading it."""

    path: Path = given(metavar="GRID", type=PATH)
    boundary_file: Path | None = given(
        "--boundary-file", type=PATH, help="Neutral map file (.nmf) with the boundaries."
    )
    read_as: tuple[str, ...] = given(
        "--read-as", metavar="KEY=VALUE", multiple=True,
        help="How to read an ambiguous Plot3D file; keys as for --variant (repeatable).",
    )  # fmt: skip

    def read(self, boundary_file: Path | None = None, ranks: Ranks = ONE_PROCESS) -> Grid:
        """The grid, in parts if there are several ranks; ``boundary_file`` is that of the case, used if the command
        line names none."""
        from meshdeform_formats.files import invalid_path
        from meshdeform_formats.grids import read_grid_with_boundaries

        options = parse_pairs(self.read_as, "--read-as")
        if not self.path.exists() and (beside := invalid_path(self.path)).exists():
            raise FormatError(f"{self.path} does not exist; {beside} is the invalid grid of a run")
        with stage("read"):
            return read_grid_with_boundaries(self.path, self.boundary_file or boundary_file, options, ranks)

    def block_sizes(self) -> Layout | None:
        """The blocks of the grid from the header of its file, if that tells."""
        from meshdeform_formats.grids import layout_of

        return layout_of(self.path, parse_pairs(self.read_as, "--read-as"))

    @property
    def files(self) -> Files:
        """The files of the input."""
        return [("grid", self.path), ("boundary file", self.boundary_file)]


grid_options = packed(GridInput, "source")


@dataclass(frozen=True)
class CaseInput:
    """The case as given on the command line; ``times`` are those of a series."""

    file: Path | None = given("-c", "--case", type=PATH, help="Case file (TOML).")
    displacement: Path | None = given("-d", "--displacement", type=PATH, help="Surface displacement table.")
    match: str | None = given(
        "--match", metavar="HOW", help="For -d: exact, nearest or interpolate (default: what fits the table)."
    )
    tolerance: float | None = given(
        "--tolerance", type=FiniteNumber(), metavar="T", help="For -d: largest distance of a match."
    )
    overrides: tuple[str, ...] = given(
        "-s", "--set", metavar="KEY=VALUE", multiple=True,
        help="Override a key of the case, like method.idw.alpha=0.3 (repeatable).",
    )  # fmt: skip
    min_jacobian: float | None = given(
        "--min-jacobian", type=float, metavar="R", help="Count a cell as invalid below R times its undeformed Jacobian."
    )
    method: str | None = given(
        "-m", "--method", metavar="NAME", help="tfi, idw, rbf or a hybrid like idw-tfi (the default)."
    )
    repair: str | None = given(
        "--repair", type=click.Choice(["auto", "off", "polish"]),
        help="auto (default): repair invalid and weak cells; off: never; polish: improve the worst cells of any grid.",
    )  # fmt: skip
    steps: int | str | None = given(
        "--steps", metavar="N|auto", callback=_steps,
        help="Impose the motion, or that to each level of a series, in N steps; by default in as many as needed.",
    )  # fmt: skip
    at_time: float | None = given(
        "--time", type=FiniteNumber(), metavar="T", help="Evaluate the motion at this time (default 0)."
    )
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

    def files(self, read: CaseFile) -> Files:
        """The files of the input, and those named in the case ``read``."""
        return [("case", self.file), *(("displacement", path) for path in read.files)]

    @property
    def empty(self) -> bool:
        """Whether it says nothing about a motion."""
        others = self.file, self.displacement, self.repair, self.min_jacobian
        return all(each is None for each in others) and not self.overrides


@dataclass(frozen=True)
class RunInput:
    """Limits, outputs and verbosity of a command."""

    reports: tuple[Path, ...] = given(
        "--report", type=PATH, multiple=True,
        help="Report file; the suffix selects .json .txt or .html, - is JSON to stdout (repeatable).",
    )  # fmt: skip
    as_json: bool = given("--json", is_flag=True, help="Print JSON on stdout, everything else on stderr.")
    threads: int | None = given(
        "--threads", type=click.IntRange(min=1), callback=_use_threads, help="Use at most this many threads."
    )
    max_memory: str | None = given(
        "--max-memory", metavar="SIZE",
        help="Memory limit, like 2GiB. Larger grids are kept in temporary files; what does not fit even so is refused.",
    )  # fmt: skip
    variant: tuple[str, ...] = given(
        "--variant", metavar="KEY=VALUE", multiple=True,
        help="How to write the output. plot3d: encoding=ascii|binary|fortran byte_order=little|big "
        "precision=float32|float64 markers=4|8 records=block|array|plane multiblock=true|false iblank=true|false "
        "dimension=2|3; vtk: encoding=ascii, or binary (.vtk), appended (.vts, .vtm); cgns: precision; "
        "openfoam: encoding=binary|ascii thickness=LENGTH (2-D grids); .msh: encoding=binary|ascii; .vtu: "
        "boundary=true|false (repeatable).",
    )  # fmt: skip
    fields: tuple[str, ...] = given(
        "--field", metavar="NAME", multiple=True,
        help="Write this into VTK and CGNS files too: displacement, invalid, a measure of `meshdeform plot`, or all "
        "(repeatable).",
    )  # fmt: skip
    dry_run: bool = given("--dry-run", is_flag=True, help="Show what would be done; write nothing.")
    force: bool = given("--force", is_flag=True, help="Overwrite an existing output (never the input).")
    allow_invalid: bool = given(
        "--allow-invalid", is_flag=True, help="Write the grid and exit 0 even if cells became invalid."
    )
    strict: bool = given("--strict", is_flag=True, help="Treat warnings as errors: exit code 2, no grid is written.")
    quiet: bool = given("-q", "--quiet", is_flag=True, help="Print errors and warnings only.")
    verbose: bool = given("-v", "--verbose", is_flag=True, help="Show stages and their times on stderr.")

    told: set[str] = dataclasses.field(default_factory=set)
    """Kinds of the warnings that have been printed."""

    def warn(self, warnings: Iterable[str]) -> None:
        """Print the first warning of each kind on stderr, even with ``-q``; with ``--strict`` any is an error."""
        new = first_of_each_kind(warnings, self.told)
        for text in new:
            tell(f"warning: {text}")
        # Warnings read back from a report have no kind, so that their texts are remembered, too.
        self.told.update(*((kind_of(text), str(text)) for text in new))
        if self.strict and new:
            raise CaseError(f"{'a warning' if len(new) == 1 else f'{len(new)} warnings'} (see above) and --strict")

    def limit(self, ranks: Ranks = ONE_PROCESS) -> MemoryLimit:
        """The limit of memory."""
        text, option = self.max_memory, "--max-memory"
        return machine_memory(ranks) if text is None else parse_memory(text, option, ranks)

    def memory(self, ranks: Ranks = ONE_PROCESS) -> MemoryLimit:
        """The limit of memory, less what pictures of a report take."""
        limit, drawn = self.limit(ranks), any(path.suffix.lower() == ".html" for path in self.reports)
        return limit.after(PICTURE_BYTES, "pictures of the report") if drawn else limit

    @property
    def variant_options(self) -> dict[str, str]:
        """How to write the output, by key."""
        return parse_pairs(self.variant, "--variant")


@dataclass(frozen=True)
class SeriesInput:
    """Output folder, times, mode and format of the levels."""

    output: Path = given("-o", "--output", type=PATH, required=True, help="Folder for the levels; created if missing.")
    times: str | None = given(
        "--times", metavar="START:STOP:STEP",
        help="Time levels, or a list a,b,c; by default those of the case's sequence of displacement files.",
    )  # fmt: skip
    velocity: str = given(
        "--velocity", type=click.Choice(("none", "first", "second", "swept")), default="none", show_default=True,
        help="Write the grid velocity, by backward differences of this order, or the volumes swept by the cell faces "
        "as well (VTK and CGNS).",
    )  # fmt: skip
    suffix: str | None = given("--suffix", help="Format of the levels, by suffix (default: that of GRID).")
    resume: bool = given("--resume", is_flag=True, help="Continue an interrupted run of the same series.")
