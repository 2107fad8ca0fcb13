"""Case files: TOML tables checked key by key and turned into the core's records.

A case is data: formulas go through :mod:`meshdeform_core.boundary.motions.expression`, and every unknown key is an
error.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import Expression
from meshdeform_core.boundary.motions.motion import VARIABLES, Displace, Follow, Motion, Rotate, Step
from meshdeform_core.boundary.tables.matching import AUTOMATIC, Matching, SurfaceData
from meshdeform_core.deform import Case
from meshdeform_core.errors import CaseError, MethodError, suggestion
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE
from meshdeform_core.methods import IDW, RBF, TFI, Options, entry_of
from meshdeform_core.repair import RepairOptions
from meshdeform_core.wording import literal

from ..displacement import read_displacement
from .components import ComponentFile, components_of
from .motions import WITHOUT_MATCHING, modes_of
from .reach import unread
from .sequences import named_files, read_sequence, sequence_files
from .toml import TABLES, load, override
from .values import Table, check_keys, fail, file_of, formula_of, number_of, plain, table_of, three_of

_KINDS = {kind.label: kind for kind in reversed(Kind) if kind is not Kind.INTERFACE}
_STEPS = {
    "rotate": ("rotate",),
    "translate": ("translate",),
    "displace": ("displace",),
    "file": ("file", "match", "tolerance"),
    "files": ("files", "times", "match", "tolerance"),
    "ffd": ("ffd",),
    "rigid": ("rigid",),
    "modes": ("modes", "match", "tolerance"),
    "airfoil": ("airfoil",),
    "positions": ("positions",),
}


@dataclass(frozen=True)
class CaseFile:
    """A case with the content of its file.

    ``boundary_file`` is a neutral map file with the grid's boundary information, or ``None``; ``files`` are all files
    that the case names; ``content`` are its tables, including the changes by the command line; ``component_files`` are
    components in files of their own.
    """

    case: Case
    boundary_file: Path | None = None
    files: tuple[Path, ...] = ()
    content: Mapping[str, Any] = field(default_factory=dict)
    component_files: Mapping[str, ComponentFile] = field(default_factory=dict)


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

    Raises
    ------
    CaseError
        With the file, the key and the nearest known one.
    """
    path = Path(path) if path else None
    data, overrides = load(path), tuple(overrides)
    for text in overrides:
        override(data, text)
    folder = path.parent if path else Path()
    if method:
        _require_method(method)
    try:
        if method:
            data.setdefault("method", {})
            table_of(data, "method")["name"] = method
        parsed = _parse(data, folder, overrides)
    except (CaseError, MethodError) as error:
        raise type(error)(f"{_origin(path, folder, bool(overrides or method))}: {error}") from error
    return (
        parsed
        if table is None
        else _with_table(parsed, Path(table), times, matching or Matching(AUTOMATIC, partial=True))
    )


def _origin(path: Path | None, folder: Path, changed: bool) -> str:
    """What an error concerns: the command line, if there is no file or it had no error before it was ``changed``."""
    if path is not None and changed:
        with suppress(CaseError, MethodError):
            _parse(load(path), folder)
            return "command line"
    return str(path or "command line")


def _require_method(name: str) -> None:
    """Check the method of the command line before the case file, so that the message does not name the file."""
    try:
        entry_of(name)
    except MethodError as error:
        raise MethodError(f"--method {name}: {error}") from None


def case_of(content: Mapping[str, Any], folder: str | Path = ".") -> CaseFile:
    """A case from the content of a case file, for cases made in Python.

    In addition to TOML content, ``file`` of a motion may be a :class:`SurfaceData` in memory. Relative file names
    refer to ``folder``.

    Raises
    ------
    CaseError
        With the key and the nearest known one.
    """
    return _parse(plain(content), Path(folder))


def _with_table(parsed: CaseFile, table: Path, times: str | None, matching: Matching) -> CaseFile:
    """The case with an additional boundary entry: the nodes matched by a table or a sequence of tables."""
    where = f"--displacement {table}"
    step: Step
    if times is None:
        step, files = Follow(read_displacement(table), matching), [table]
    else:
        step = read_sequence(str(table), times, Path(), matching, where)
        files = sequence_files(str(table), Path(), where)
    spec = BoundarySpec(table.name, ("*",), Kind.MOVING, None, Motion((step,), parsed.case.constants))
    case = replace(parsed.case, boundaries=(*parsed.case.boundaries, spec))
    return replace(parsed, case=case, files=(*parsed.files, *files))


def _parse(data: Table, folder: Path, overrides: Sequence[str] = ()) -> CaseFile:
    check_keys(data, TABLES, "case")
    grid = table_of(data, "grid")
    check_keys(grid, ("boundary_file", "tolerance", "open", "plates", "components"), "[grid]")
    constants = _constants(table_of(data, "constants"))
    entries = data.get("boundary", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise fail("boundary", "expected [[boundary]] entries (double brackets)")
    specs = tuple(_boundary(entry, number, constants, folder) for number, entry in enumerate(entries, 1))
    names = [spec.name for spec in specs]
    if len(set(names)) < len(names):
        raise fail("boundary", f"names must differ, found {names}")
    tolerance = number_of(grid.get("tolerance", RELATIVE_TOLERANCE), "grid.tolerance")
    if not 0 < tolerance < 0.5:
        raise fail("grid.tolerance", f"{tolerance} of the local edge; expected a fraction between 0 and 0.5")
    options = _options(table_of(data, "method"))
    notes, repair = unread(data, specs, options, overrides), _repair(table_of(data, "repair"))
    components = components_of(grid, folder)
    case = Case(
        specs, constants, options, tolerance, notes, _open_faces(grid), repair, _plates(grid), components.patterns
    )
    boundary_file = file_of(grid["boundary_file"], folder, "[grid]: boundary_file") if "boundary_file" in grid else None
    return CaseFile(case, boundary_file, tuple(named_files(data, folder)), data, components.files)


def _open_faces(grid: Table) -> bool | tuple[str, ...]:
    """``grid.open``: true, or a list of faces."""
    value = grid.get("open", False)
    if isinstance(value, bool):
        return value
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise fail("grid.open", f'expected true, or faces like ["block1.imax"], found {literal(value)}')
    return tuple(value)


def _plates(grid: Table) -> tuple[str, ...]:
    """``grid.plates``: a list of faces."""
    value = grid.get("plates", [])
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise fail("grid.plates", f'expected faces like ["block1.kmax[10:20,*]"], found {literal(value)}')
    return tuple(value)


def _repair(table: Table) -> RepairOptions:
    check_keys(table, ("mode", "min_jacobian", "time_limit"), "[repair]")
    smallest = number_of(table.get("min_jacobian", 0.0), "repair.min_jacobian")
    seconds = number_of(table.get("time_limit", RepairOptions.time_limit), "repair.time_limit")
    try:
        return RepairOptions(table.get("mode", "auto"), smallest, seconds)
    except CaseError as error:
        raise fail("repair", str(error)) from None


def _constants(table: Table) -> dict[str, float]:
    constants = {name: number_of(value, f"constants.{name}") for name, value in table.items()}
    for name in constants:
        if name in VARIABLES or name == "pi" or keyword.iskeyword(name):
            raise fail(f"constants.{name}", f"{name} already has a meaning in formulas; choose another name")
        if not name.isidentifier():
            raise fail(f"constants.{name}", "expected a name of letters, digits and _ only")
    return constants


def _boundary(entry: Table, number: int, constants: Mapping[str, float], folder: Path) -> BoundarySpec:
    name = entry.get("name", f"boundary {number}")
    where = f"boundary {literal(name)}"
    check_keys(entry, ("name", "select", "where", "kind", "motion"), where)
    if not isinstance(name, str):
        raise fail(where, f"name = {literal(name)}; expected a string in quotes")
    kind = _kind(entry, where)
    select = entry.get("select", ["*"])
    select = [select] if isinstance(select, str) else select
    if not isinstance(select, list) or not select or not all(isinstance(item, str) for item in select):
        raise fail(where, f'select = {literal(select)}; expected a list of names, like ["wing", "block2.jmin"]')
    steps = entry.get("motion", [])
    if (kind is Kind.MOVING) != bool(steps):
        missing = "moves but has no motion" if kind is Kind.MOVING else f"is {kind.label} but has a motion"
        raise fail(where, f'{missing}; expected motion = [...] for kind = "moving", and only for this kind')
    condition = _condition(entry["where"], constants, where) if "where" in entry else None
    motion = _motion(steps, constants, where, folder) if steps else None
    return BoundarySpec(name, tuple(select), kind, condition, motion)


def _condition(value: Any, constants: Iterable[str], where: str) -> Expression:
    condition = formula_of(value, (*constants, "x", "y", "z"), f"{where}: where")
    if not condition.is_condition:
        raise fail(
            where, f"where = {literal(value)} is neither true nor false; expected a condition, like x > 0.5 and y < 1"
        )
    return condition


def _kind(entry: Table, where: str) -> Kind:
    """The kind of the entry; ``moving`` if it has a motion but no kind."""
    known = f"expected one of {', '.join(_KINDS)}"
    if "kind" not in entry and "motion" not in entry:
        raise fail(where, f"has no kind; {known}")
    kind = entry.get("kind", "moving")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise fail(where, f"kind = {literal(kind)}; {known}{suggestion(kind, _KINDS)}")
    return _KINDS[kind]


def _motion(steps: Any, constants: Mapping[str, float], where: str, folder: Path) -> Motion:
    if isinstance(steps, dict):
        steps = [steps]
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise fail(where, "motion: expected a list of tables, like [{ translate = [0, 0.1, 0] }]")
    known = (*constants, *VARIABLES)
    return Motion(tuple(_step(step, n, known, where, folder) for n, step in enumerate(steps, 1)), dict(constants))


def _step(step: Table, number: int, known: tuple[str, ...], where: str, folder: Path) -> Step:
    where = f"{where}, motion step {number}"
    kinds = [name for name in _STEPS if name in step]
    if len(kinds) != 1:
        raise fail(where, f"found {sorted(step)}; expected exactly one of {', '.join(_STEPS)}{_guess(step)}")
    check_keys(step, _STEPS[kinds[0]], where)
    value = step[kinds[0]]
    if kinds[0] == "file":
        in_memory = isinstance(value, SurfaceData)
        data = value if in_memory else read_displacement(file_of(value, folder, f"{where}: file"))
        return Follow(data, _matching(step, where))
    if kinds[0] == "files":
        return read_sequence(value, step.get("times"), folder, _matching(step, where), where)
    if kinds[0] == "modes":
        return modes_of(value, _matching(step, where), known, folder, where)
    if kinds[0] in WITHOUT_MATCHING:
        return WITHOUT_MATCHING[kinds[0]](value, known, folder, where)
    if kinds[0] == "rotate":
        return _rotation(value, known, where)
    x, y, z = (formula_of(part, known, where) for part in three_of(value, f"{where}: {kinds[0]}"))
    return Displace((x, y, z))


def _matching(step: Table, where: str) -> Matching:
    tolerance = number_of(step["tolerance"], f"{where}: tolerance") if "tolerance" in step else None
    try:
        return Matching(step.get("match", "nearest"), tolerance)
    except CaseError as error:
        raise fail(where, str(error)) from None


def _rotation(value: Any, known: tuple[str, ...], where: str) -> Rotate:
    if not isinstance(value, dict):
        raise fail(where, f"rotate = {literal(value)}; expected {{ angle = degrees, axis = [..], center = [..] }}")
    check_keys(value, ("angle", "axis", "center"), f"{where}, rotate")
    if "angle" not in value:
        raise fail(where, "rotate has no angle; expected degrees, or a formula of t")
    axis = [number_of(a, f"{where}: axis") for a in three_of(value.get("axis", [0, 0, 1]), f"{where}: axis")]
    if not any(axis):
        raise fail(where, "axis = [0, 0, 0] has no direction")
    center = [formula_of(c, known, where) for c in three_of(value.get("center", [0, 0, 0]), f"{where}: center")]
    return Rotate(
        formula_of(value["angle"], known, where), (axis[0], axis[1], axis[2]), (center[0], center[1], center[2])
    )


def _guess(step: Table) -> str:
    return next((hint for key in step if (hint := suggestion(key, _STEPS))), "")


def _options(table: Table) -> Options:
    check_keys(table, [f.name for f in fields(Options)], "[method]")
    name = table.get("name", Options().name)
    if not isinstance(name, str):
        raise fail("method.name", f"expected a name, found {literal(name)}")
    parts = {part: _build(kind, table_of(table, part, "method."), f"[method.{part}]")
             for part, kind in (("idw", IDW), ("rbf", RBF), ("tfi", TFI))}  # fmt: skip
    return Options.relevant(name, **parts)


def _build(kind: type, table: Table, where: str) -> Any:
    """A dataclass of options from its table, whose keys are the fields."""
    check_keys(table, [f.name for f in fields(kind)], where)
    return kind(**table)
