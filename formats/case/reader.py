"""Case files: TOML tables turned into the core's records; their JSON schema, with which editors complete and check.

A case is data: formulas go through :mod:`meshdeform_core.boundary.motions.expression`, and every unknown key is an
error.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import VARIABLES, Follow, Motion, Step
from meshdeform_core.boundary.tables import AUTOMATIC, Matching
from meshdeform_core.deform import Case
from meshdeform_core.errors import CaseError, MethodError, suggestion
from meshdeform_core.grid.selection import Components
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE
from meshdeform_core.methods import ALIASES, CATALOGUE, PARTS, MethodOptions, Options, declared, entry_of
from meshdeform_core.repair import RepairOptions
from meshdeform_core.repair.options import Mode
from meshdeform_core.wording import literal

from .forms import File, Form, Table, about, filled, load, override, placed, plain
from .motions import KINDS as MOTIONS
from .motions import MotionStep
from .tables import files_over_time, named_files

_Names = Annotated[tuple[str, ...], Meta(min_length=1)]
_Setting = tuple[str, list[str], Any]
"""``KEY=VALUE``, the names of KEY, and the value."""
_KINDS = ", ".join(kind.label for kind in reversed(Kind) if kind is not Kind.INTERFACE)


class GridForm(Form):
    """How to read the grid."""

    boundary_file: Annotated[File | None, about("a file name: NASA neutral map, relative to the case file")] = None
    tolerance: Annotated[
        float,
        Meta(gt=0, lt=0.5),
        about("a finite number, between 0 and 0.5 of the edge at coincident nodes"),
    ] = RELATIVE_TOLERANCE
    open: Annotated[
        bool | tuple[str, ...], about('true, or faces like ["block1.imax"]: outside faces meant to lie close to others')
    ] = False
    plates: Annotated[
        tuple[str, ...], about('faces like ["block1.kmax[10:20,*]"] between blocks that are walls on both sides')
    ] = ()
    components: Annotated[
        Literal["", "zone prefix"] | Annotated[dict[str, str | _Names], Meta(min_length=1)],
        about('"zone prefix", or names with block patterns, like { wing = ["wing*"], flap = ["flap*"] }'),
    ] = ""


class BoundaryForm(Form):
    """One part of the boundary."""

    name: Annotated[str | None, about("a string in quotes: its name in reports")] = None
    select: Annotated[
        str | _Names, about('a list of names, like ["wing", "block2.jmin[1:65,*]"]; default: all outside faces')
    ] = ("*",)
    where: Annotated[
        str | None, about("a formula that is a condition, like x > 0.5 and y < 1, for all corners of a face")
    ] = None
    kind: Annotated[
        Literal["moving", "fixed", "symmetry", "slip", "periodic", "free"] | None,
        about(f"one of {_KINDS}; default: moving if it has a motion"),
    ] = None
    motion: Annotated[
        MotionStep | tuple[MotionStep, ...], about("a list of tables, like [{ translate = [0, 0.1, 0] }]")
    ] = ()


class RepairForm(Form):
    """Treatment of cells that become invalid."""

    mode: Annotated[Mode, about("auto, off or polish")] = "auto"
    min_jacobian: Annotated[
        float, about("a finite number: cells with a corner below this share of its original are invalid")
    ] = RepairOptions.min_jacobian
    time_limit: Annotated[
        float, about("a finite number: no further repair or attempt begins after so many seconds")
    ] = RepairOptions.time_limit


def _form_of_options(kind: type[MethodOptions]) -> type[msgspec.Struct]:
    """The form of a table of options, whose values the options check themselves."""
    entries = []
    for name, option in declared(kind).items():
        values: list[Table] = [{"enum": list(option.choices)}] if option.choices else []
        if option.number is not None:
            number: Table = {"type": "integer" if option.number is int else "number"}
            number["exclusiveMinimum" if option.open_low else "minimum"] = option.low
            if option.high < float("inf"):
                number["maximum"] = option.high
            values.append(number)
        entries.append((name, Annotated[Any, about(option.meaning, anyOf=values)], option.default))
    return msgspec.defstruct(f"{kind.__name__}Form", entries, bases=(Form,), namespace={"__doc__": "Its options."})


_NAME = Annotated[str, about("a name, see `meshdeform methods`", enum=[*CATALOGUE, *ALIASES])]
_PARTS = ((part, _form_of_options(kind)) for part, kind in PARTS.items())
MethodForm = msgspec.defstruct(
    "MethodForm",
    [("name", _NAME, Options().name)]
    + [
        (part, Annotated[own, about(f"a table [method.{part}]")], msgspec.field(default_factory=own))
        for part, own in _PARTS
    ],
    bases=(Form,),
    namespace={"__doc__": "The method and its options."},
)


class CaseForm(Form):
    """meshdeform case file"""

    grid: Annotated[GridForm, about("a table [grid]")] = msgspec.field(default_factory=GridForm)
    constants: Annotated[
        dict[str, Any], about("a table [constants] of names for numbers", additionalProperties={"type": "number"})
    ] = msgspec.field(default_factory=dict)
    boundary: Annotated[tuple[BoundaryForm, ...], about("[[boundary]] entries (double brackets)")] = ()
    method: Annotated[MethodForm, about("a table [method]")] = msgspec.field(  # type: ignore[valid-type]
        default_factory=MethodForm
    )
    repair: Annotated[RepairForm, about("a table [repair]")] = msgspec.field(default_factory=RepairForm)


@dataclass(frozen=True)
class CaseFile:
    """A case with the content of its file.

    ``boundary_file`` is a neutral map file with the grid's boundary information, or ``None``; ``files`` are all files
    that the case names; ``content`` are its tables, including the changes by the command line.
    """

    case: Case
    boundary_file: Path | None = None
    files: tuple[Path, ...] = ()
    content: Mapping[str, Any] = field(default_factory=dict)


def read_case(
    path: str | Path | None,
    overrides: Iterable[str] = (),
    method: str | None = None,
    table: str | Path | None = None,
    times: str | None = None,
    matching: Matching | None = None,
) -> CaseFile:
    """Read a case file and apply the additions of the command line.

    Parameters
    ----------
    path : TOML file, or ``None`` for an empty case
    overrides : ``KEY=VALUE`` strings; KEY is a dotted path, with entries of ``boundary`` by name or 1-based number
    method : replaces ``method.name``
    table : displacement table; the boundary nodes that it matches move, all others are fixed
    times : if given, ``table`` is a pattern of files, one for each of these times (see :func:`parse_times`)
    matching : how ``table`` is matched

    Raises CaseError with the file, the key and the nearest known one.
    """
    path = Path(path) if path else None
    data, settings, folder = load(path), list[_Setting](), path.parent if path else Path()
    for text in overrides:
        with placed(f"--set {text!r}"):
            settings.append((text, *override(data, text)))
    if method:
        try:
            # Before the case file, so that the message does not name it.
            entry_of(method)
        except MethodError as error:
            raise MethodError(f"--method {method}: {error}") from None
    try:
        if method and isinstance(data.setdefault("method", {}), dict):
            data["method"]["name"] = method
        parsed = _parse(data, folder, settings)
    except (CaseError, MethodError) as error:
        # The command line is at fault if there is no file, or it has no error without the changes.
        origin = str(path or "command line")
        if path is not None and (settings or method):
            with suppress(CaseError, MethodError):
                _parse(load(path), folder)
                origin = "command line"
        raise type(error)(f"{origin}: {error}") from error
    if table is None:
        return parsed
    from ..displacement import read_displacement

    table, matching = Path(table), matching or Matching(AUTOMATIC, partial=True)
    if times is None:
        step, files = Follow(read_displacement(table), matching), [table]
    else:
        with placed(f"--displacement {table}"):
            files, when = files_over_time(str(table), times, Path())
        step = Follow(lambda number: read_displacement(files[number]), matching, when)
    spec = BoundarySpec(table.name, ("*",), Kind.MOVING, None, Motion((step,), parsed.case.constants))
    case = replace(parsed.case, boundaries=(*parsed.case.boundaries, spec))
    return replace(parsed, case=case, files=(*parsed.files, *files))


def case_of(content: Mapping[str, Any], folder: str | Path = ".") -> CaseFile:
    """A case from the content of a case file, for cases made in Python.

    In addition to TOML content, ``file`` of a motion may be a :class:`SurfaceData` in memory. Relative file names
    refer to ``folder``.

    Raises CaseError with the key and the nearest known one.
    """
    return _parse(content, Path(folder))


def _parse(content: Mapping[str, Any], folder: Path, settings: Sequence[_Setting] = ()) -> CaseFile:
    data = plain(content)
    form = filled(CaseForm, data)
    for name, value in form.constants.items():
        with placed(f"constants.{name}"):
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise CaseError(f"expected a finite number, found {literal(value)}")
            if name in VARIABLES or name == "pi" or keyword.iskeyword(name):
                raise CaseError(f"{name} already has a meaning in formulas; choose another name")
            if not name.isidentifier():
                raise CaseError("expected a name of letters, digits and _ only")
    constants = {name: float(value) for name, value in form.constants.items()}
    specs = list[BoundarySpec]()
    for number, entry in enumerate(form.boundary, start=1):
        name = f"boundary {number}" if entry.name is None else entry.name
        with placed(f"boundary {literal(name)}"):
            specs.append(_boundary_spec(name, entry, constants, folder))
    names = [spec.name for spec in specs]
    if len(set(names)) < len(names):
        raise CaseError(f"boundary: names must differ, found {names}")
    method: Any = form.method
    parts = {part: kind(**msgspec.structs.asdict(getattr(method, part))) for part, kind in PARTS.items()}
    options = Options.relevant(method.name, **parts)
    with placed("repair"):
        repair = RepairOptions(**msgspec.structs.asdict(form.repair))
    grid = form.grid
    components: Components = grid.components
    if not isinstance(components, str):
        components = {name: (each,) if isinstance(each, str) else each for name, each in components.items()}
    unread = _unread(data, specs, options, settings)
    case = Case(tuple(specs), constants, options, grid.tolerance, unread, grid.open, repair, grid.plates, components)
    boundary_file = None if grid.boundary_file is None else folder / grid.boundary_file
    return CaseFile(case, boundary_file, tuple(named_files(data, folder)), data)


def _boundary_spec(name: str, entry: BoundaryForm, constants: Mapping[str, float], folder: Path) -> BoundarySpec:
    steps = [entry.motion] if isinstance(entry.motion, MotionStep) else entry.motion
    if entry.kind is None and not steps:
        raise CaseError(f"has no kind; expected one of {_KINDS}")
    kind = Kind[(entry.kind or "moving").upper()]
    if (kind is Kind.MOVING) != bool(steps):
        missing = "moves but has no motion" if kind is Kind.MOVING else f"is {kind.label} but has a motion"
        raise CaseError(f'{missing}; expected motion = [...] for kind = "moving", and only for this kind')
    condition = None
    if entry.where is not None:
        with placed("where"):
            condition = expression(entry.where, (*constants, "x", "y", "z"))
            if not condition.is_condition:
                found = f"{literal(entry.where)} is neither true nor false"
                raise CaseError(f"{found}; expected a condition, like x > 0.5 and y < 1")
    built = list[Step]()
    for number, step in enumerate(steps, start=1):
        with placed(f"motion step {number}"):
            built.append(step.step((*constants, *VARIABLES), folder))
    motion = Motion(tuple(built), dict(constants)) if built else None
    select = (entry.select,) if isinstance(entry.select, str) else entry.select
    return BoundarySpec(name, select, kind, condition, motion)


def _unread(
    data: Table, specs: Sequence[BoundarySpec], options: Options, settings: Sequence[_Setting]
) -> tuple[str, ...]:
    """Warnings about unused content of the case file, ``data``.

    Raises CaseError for unused ``settings``, with the reason, and the nearest name that is used.
    """
    used = set[str]()
    for spec in specs:
        used |= spec.where.names if spec.where else set()
        used |= spec.motion.names if spec.motion else set()
    used -= {"x", "y", "z", "t"}
    for text, path, value in settings:
        constants = () if path[0] != "constants" else path[1:2] if len(path) > 1 else value
        for name in constants:
            if name not in used:
                others = f"; used are {', '.join(sorted(used))}" if used else "; none uses any"
                known = suggestion(name, used) or others
                raise CaseError(f"--set {text!r}: no formula uses the constant {name!r}{known}")
        if path[0] == "method" and len(path) > 1 and path[1] in PARTS:
            own, parts = getattr(options, path[1]), entry_of(options.name).parts
            reason = own.idle.get(path[2], "") if len(path) > 2 else ""
            if type(own) not in parts:
                names = ", ".join(f"method.{kind.__name__.lower()}" for kind in parts) or "no options"
                reason = f"the method {options.name!r} uses only {names}"
            if reason:
                raise CaseError(f"--set {text!r} has no effect: {reason}")
    idle = [name for name in data.get("constants", {}) if name not in used]
    return tuple(f"no formula uses the constant {name!r}{suggestion(name, used)}" for name in idle)


def case_schema() -> Table:
    """The schema (draft 2020-12) of a case file, as data."""
    schema = msgspec.json.schema(CaseForm)
    definitions = schema["$defs"]
    definitions["MotionStep"]["oneOf"] = [{"required": [name]} for name in MOTIONS]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:meshdeform:case:1",
        "$ref": schema["$ref"],
        "$defs": definitions,
    }
