"""Case files: TOML tables checked key by key and turned into the core's records.

A case is data: formulas go through :mod:`meshdeform_core.expression`, and every key that is not known is an error.
"""

from __future__ import annotations

import difflib
import keyword
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.expression import Expression, expression
from meshdeform_core.methods import IDW, RBF, TFI, Options
from meshdeform_core.motion import VARIABLES, Displace, Follow, Motion, Rotate, Step
from meshdeform_core.topology import RELATIVE_TOLERANCE
from meshdeform_core.transfer import Matching

from .case_files import named_files, read_sequence, sequence_files
from .displacement import read_displacement

Table = dict[str, Any]
_TOO_LONG = "it has an integer of more than 64 bits; write large numbers like 1e30"
_KINDS = {kind.label: kind for kind in reversed(Kind) if kind is not Kind.INTERFACE}
_STEPS = {
    "rotate": ("rotate",),
    "translate": ("translate",),
    "displace": ("displace",),
    "file": ("file", "match", "tolerance"),
    "files": ("files", "times", "match", "tolerance"),
}


@dataclass(frozen=True)
class CaseFile:
    """A case and what the case file says about reading the grid.

    ``boundary_file`` is a neutral map file with the grid's boundary information, or ``None``; ``files`` are all that
    the case names, relative to its folder; ``content`` are its tables with everything that the command line changed.
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
) -> CaseFile:
    """Read a case file and apply what the command line adds.

    Parameters
    ----------
    path : TOML file, or ``None`` for an empty case
    overrides : ``KEY=VALUE`` strings; KEY is a dotted path, entries of ``boundary`` go by name or 1-based number
    method : replaces ``method.name``
    table : displacement table; the boundary nodes that it matches move, all others stay
    times : if given, ``table`` is a pattern of files, one for each of these times (see :func:`parse_times`)

    Raises
    ------
    CaseError
        Naming the file, the key and the nearest known one.
    """
    path = Path(path) if path else None
    data = _load(path)
    for text in overrides:
        _override(data, text)
    folder = path.parent if path else Path()
    try:
        if method:
            data.setdefault("method", {})
            _table(data, "method")["name"] = method
        parsed = _parse(data, folder)
    except (CaseError, MethodError) as error:
        raise type(error)(f"{path or 'command line'}: {error}") from error
    return parsed if table is None else _with_table(parsed, Path(table), times)


def _with_table(parsed: CaseFile, table: Path, times: str | None) -> CaseFile:
    """The case with one more boundary entry: what a table, or a sequence of tables, matches."""
    matching, where = Matching(partial=True), f"--displacement {table}"
    step: Step
    if times is None:
        step, files = Follow(read_displacement(table), matching), [table]
    else:
        step = read_sequence(str(table), times, Path(), matching, where)
        files = sequence_files(str(table), Path(), where)
    spec = BoundarySpec(table.name, ("*",), Kind.MOVING, None, Motion((step,), parsed.case.constants))
    case = replace(parsed.case, boundaries=(*parsed.case.boundaries, spec))
    return replace(parsed, case=case, files=(*parsed.files, *files))


def _load(path: Path | None) -> Table:
    if path is None:
        return {}
    try:
        return _toml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CaseError(f"cannot read the case file {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise CaseError(f"{path} is not a TOML file: {error}") from error


def _toml(text: str) -> Table:
    """Parse TOML; ``ValueError`` for anything else, also for the integers beyond 64 bits that TOML does not have."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None
    except ValueError:
        raise ValueError(_TOO_LONG) from None
    _require_64_bits(data)
    return data


def _require_64_bits(value: Any) -> None:
    if isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            _require_64_bits(item)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(_TOO_LONG)


def _fail(where: str, message: str) -> CaseError:
    return CaseError(f"{where}: {message}")


def _override(data: Table, text: str) -> None:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise CaseError(f"--set {text!r}: expected KEY=VALUE, like method.idw.alpha=0.3")
    try:
        (parsed,) = _toml(f"value = {value}").values()
    except ValueError:
        parsed = value.strip()
    *path, last = key.strip().split(".")
    target: Any = data
    for name in path:
        target = target.setdefault(name, {}) if isinstance(target, dict) else _entry(target, name, text)
        if not isinstance(target, (dict, list)):
            raise CaseError(f"--set {text!r}: {name!r} is a value, not a table")
    if isinstance(target, list):
        raise CaseError(
            f"--set {text!r}: {'.'.join(path)} is a list; name an entry and its key, like "
            f'boundary.wing.kind="fixed", or give the list as a whole'
        )
    target[last] = parsed


def _entry(entries: list[Any], name: str, text: str) -> Any:
    for number, entry in enumerate(entries, 1):
        if isinstance(entry, dict) and (entry.get("name") == name or str(number) == name):
            return entry
    known = [str(e.get("name", n)) for n, e in enumerate(entries, 1) if isinstance(e, dict)]
    raise CaseError(f"--set {text!r}: no entry {name!r}; known are {', '.join(known) or 'none'}")


def _parse(data: Table, folder: Path) -> CaseFile:
    _check_keys(data, ("grid", "constants", "boundary", "method"), "case")
    grid = _table(data, "grid")
    _check_keys(grid, ("boundary_file", "tolerance"), "[grid]")
    constants = _constants(_table(data, "constants"))
    entries = data.get("boundary", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise _fail("boundary", "expected [[boundary]] entries (double brackets)")
    specs = tuple(_boundary(entry, number, constants, folder) for number, entry in enumerate(entries, 1))
    names = [spec.name for spec in specs]
    if len(set(names)) < len(names):
        raise _fail("boundary", f"names must differ, found {names}")
    tolerance = _number(grid.get("tolerance", RELATIVE_TOLERANCE), "grid.tolerance")
    if not 0 < tolerance < 0.5:
        raise _fail("grid.tolerance", f"{tolerance} of the local edge; expected a fraction between 0 and 0.5")
    case = Case(specs, constants, _options(_table(data, "method")), tolerance)
    boundary_file = _file(grid["boundary_file"], folder, "[grid]: boundary_file") if "boundary_file" in grid else None
    return CaseFile(case, boundary_file, tuple(named_files(data, folder)), data)


def _constants(table: Table) -> dict[str, float]:
    constants = {name: _number(value, f"constants.{name}") for name, value in table.items()}
    for name in constants:
        if name in VARIABLES or name == "pi" or keyword.iskeyword(name):
            raise _fail(f"constants.{name}", f"{name} already has a meaning in formulas; choose another name")
        if not name.isidentifier():
            raise _fail(f"constants.{name}", "a constant's name has letters, digits and _ only")
    return constants


def _boundary(entry: Table, number: int, constants: Mapping[str, float], folder: Path) -> BoundarySpec:
    name = entry.get("name", f"boundary {number}")
    where = f"boundary {name!r}"
    _check_keys(entry, ("name", "select", "where", "kind", "motion"), where)
    if not isinstance(name, str):
        raise _fail(where, f"name = {name!r}; expected a text in quotes")
    kind = _kind(entry, where)
    select = entry.get("select", ["*"])
    select = [select] if isinstance(select, str) else select
    if not isinstance(select, list) or not select or not all(isinstance(item, str) for item in select):
        raise _fail(where, f'select = {select!r}; expected a list of names, like ["wing", "block2.jmin"]')
    steps = entry.get("motion", [])
    if (kind is Kind.MOVING) != bool(steps):
        missing = "moves but has no motion" if kind is Kind.MOVING else f"is {kind.label} but has a motion"
        raise _fail(where, f'{missing}; expected motion = [...] for kind = "moving" and only there')
    condition = _formula(entry["where"], (*constants, "x", "y", "z"), f"{where}: where") if "where" in entry else None
    motion = _motion(steps, constants, where, folder) if steps else None
    return BoundarySpec(name, tuple(select), kind, condition, motion)


def _kind(entry: Table, where: str) -> Kind:
    """What the entry says, ``moving`` if it has a motion and says nothing."""
    known = f"expected one of {', '.join(_KINDS)}"
    if "kind" not in entry and "motion" not in entry:
        raise _fail(where, f"has no kind; {known}")
    kind = entry.get("kind", "moving")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise _fail(where, f"kind = {kind!r}; {known}{_nearest(kind, _KINDS)}")
    return _KINDS[kind]


def _motion(steps: Any, constants: Mapping[str, float], where: str, folder: Path) -> Motion:
    if isinstance(steps, dict):
        steps = [steps]
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise _fail(where, "motion: expected a list of tables, like [{ translate = [0, 0.1, 0] }]")
    known = (*constants, *VARIABLES)
    return Motion(tuple(_step(step, n, known, where, folder) for n, step in enumerate(steps, 1)), dict(constants))


def _step(step: Table, number: int, known: tuple[str, ...], where: str, folder: Path) -> Step:
    where = f"{where}, motion step {number}"
    kinds = [name for name in _STEPS if name in step]
    if len(kinds) != 1:
        raise _fail(where, f"found {sorted(step)}; expected exactly one of {', '.join(_STEPS)}{_guess(step)}")
    _check_keys(step, _STEPS[kinds[0]], where)
    value = step[kinds[0]]
    if kinds[0] == "file":
        matching = _matching(step, where)
        return Follow(read_displacement(_file(value, folder, f"{where}: file")), matching)
    if kinds[0] == "files":
        return read_sequence(value, step.get("times"), folder, _matching(step, where), where)
    if kinds[0] == "rotate":
        return _rotation(value, known, where)
    x, y, z = (_formula(part, known, where) for part in _three(value, f"{where}: {kinds[0]}"))
    return Displace((x, y, z))


def _matching(step: Table, where: str) -> Matching:
    tolerance = _number(step["tolerance"], f"{where}: tolerance") if "tolerance" in step else None
    try:
        return Matching(step.get("match", "nearest"), tolerance)
    except CaseError as error:
        raise _fail(where, str(error)) from None


def _rotation(value: Any, known: tuple[str, ...], where: str) -> Rotate:
    if not isinstance(value, dict):
        raise _fail(where, f"rotate = {value!r}; expected {{ angle = degrees, axis = [..], center = [..] }}")
    _check_keys(value, ("angle", "axis", "center"), f"{where}, rotate")
    if "angle" not in value:
        raise _fail(where, "rotate has no angle; expected degrees, or a formula of t")
    axis = [_number(a, f"{where}: axis") for a in _three(value.get("axis", [0, 0, 1]), f"{where}: axis")]
    if not any(axis):
        raise _fail(where, "axis = [0, 0, 0] has no direction")
    center = [_formula(c, known, where) for c in _three(value.get("center", [0, 0, 0]), f"{where}: center")]
    return Rotate(
        _formula(value["angle"], known, where), (axis[0], axis[1], axis[2]), (center[0], center[1], center[2])
    )


def _options(table: Table) -> Options:
    _check_keys(table, [f.name for f in fields(Options)], "[method]")
    name = table.get("name", Options().name)
    if not isinstance(name, str):
        raise _fail("method.name", f"expected a name, found {name!r}")
    parts = {part: _build(kind, _table(table, part, "method."), f"[method.{part}]")
             for part, kind in (("idw", IDW), ("rbf", RBF), ("tfi", TFI))}  # fmt: skip
    return Options(name=name, **parts)


def _build(kind: type, table: Table, where: str) -> Any:
    """A dataclass of options from its table: the fields are the keys."""
    _check_keys(table, [f.name for f in fields(kind)], where)
    return kind(**table)


def _table(data: Table, key: str, prefix: str = "") -> Table:
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise _fail(f"{prefix}{key}", f"expected a table [{prefix}{key}], found {value!r}")
    return value


def _check_keys(table: Table, known: Iterable[str], where: str) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            hint = _nearest(key, known) or f"; known are {', '.join(known)}"
            raise _fail(where, f"unknown key {key!r}{hint}")


def _nearest(word: Any, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(str(word), list(known), 1)
    return f"; did you mean {close[0]!r}?" if close else ""


def _guess(step: Table) -> str:
    return next((hint for key in step if (hint := _nearest(key, _STEPS))), "")


def _three(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list) or len(value) != 3:
        raise _fail(where, f"expected three values, found {value!r}")
    return value


def _file(value: Any, folder: Path, where: str) -> Path:
    if not isinstance(value, str) or not value or "\0" in value:
        raise _fail(where, f"expected a file name, found {value!r}")
    return folder / value


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < float("inf"):
        raise _fail(where, f"expected a finite number, found {value!r}")
    return float(value)


def _formula(value: Any, known: Iterable[str], where: str) -> Expression:
    try:
        return expression(value, known)
    except CaseError as error:
        raise _fail(where, str(error)) from None
