"""The content of a case file: its text, how its tables are declared, and its errors, which say what was found and
expected, where, and the nearest key.

A table of a case is declared by a :class:`Form`, whose fields have types, ranges and descriptions; msgspec converts,
and derives the JSON schema.
"""

from __future__ import annotations

import ctypes
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.wording import literal

from ..files import require_regular

Table = dict[str, Any]
_DEEPEST = 100


def about(text: str, **more: Any) -> Meta:
    """What an entry is, for messages and the schema; ``more`` are entries of its schema."""
    return Meta(description=text, extra_json_schema=more or None)


class Form(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A table of a case file; optional entries that are absent are ``None``."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # Never freed: where the interpreter frees such classes at its end, msgspec may read what is freed already and
        # crash (its issue 717, open; seen with 0.19 to 0.22 in a fifth of all runs).
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(cls))

    def given(self) -> list[str]:
        """Names of the entries that are not absent."""
        return sorted(name for name in self.__struct_fields__ if getattr(self, name) is not None)


Of = TypeVar("Of", bound=Form)
File = Annotated[str, Meta(min_length=1, pattern=r"^[^\0]*$")]
Formula = Annotated[float | str, about("a number or a formula in quotes")]
Three = tuple[Formula, Formula, Formula]
ThreeNumbers = tuple[float, float, float]


@contextmanager
def placed(where: str) -> Iterator[None]:
    """Errors of the content of a case say ``where`` it is."""
    try:
        yield
    except CaseError as error:
        raise CaseError(f"{where}: {error}") from None


def plain(value: Any, place: str = "") -> Any:
    """Tables, also those made in Python, in the types of TOML: dictionaries, lists, finite numbers, texts."""
    if place.count(".") > _DEEPEST:
        raise CaseError(f"its tables are nested more than {_DEEPEST} deep; expected a case like that of a case file")
    if isinstance(value, Mapping):
        return {key: plain(item, f"{place}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, f"{place}.{number}") for number, item in enumerate(value, start=1)]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), place)
    if isinstance(value, float) and not math.isfinite(value):
        raise CaseError(f"{place[1:]} = {literal(value)}; expected a finite number")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise CaseError(f"{place[1:]} is beyond integers of 64 bits, -2^63 to 2^63 - 1; write large numbers like 1e30")
    return str(value) if isinstance(value, Path) else value


def filled(form: type[Of], content: Table) -> Of:
    """The ``content`` as a form."""
    try:
        return msgspec.convert(content, form)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        steps = [name or int(number) for name, number in re.findall(r"\.([\w-]+)|\[(\d+)\]", path)]
        raise _explained(form, content, steps, message) from None


def _explained(form: type[Form], value: Any, path: Sequence[str | int], message: str) -> CaseError:
    """The error for msgspec's message about the content at a path: the place in words, like ``boundary 'body', motion
    step 1``, and what the description of the entry says is expected."""
    schema = msgspec.json.schema(form)

    def part(node: Table, what: str) -> Any:
        """An entry of a node of the schema, of one of its alternatives, or of what these refer to."""
        nodes = [node, *node.get("anyOf", ())]
        nodes += [schema["$defs"][each["$ref"].rpartition("/")[2]] for each in nodes if "$ref" in each]
        return next((each[what] for each in nodes if what in each), {})

    node, entries, keys = schema, list[str](), list[str]()
    for step in path:
        if isinstance(step, str):
            keys.append(step)
            node, value = part(node, "properties").get(step, {}), value[step]
        elif isinstance(value[step], dict):
            node, value = part(node, "items"), value[step]
            name = f"boundary {literal(value.get('name', f'boundary {step + 1}'))}"
            entries.append(
                {"boundary": name, "motion": f"motion step {step + 1}"}.get(keys[-1], f"{keys[-1]} {step + 1}")
            )
            keys = []
        else:
            # A list of numbers or names is shown as a whole.
            break
    place = ": ".join(text for text in (", ".join(entries), ".".join(keys)) if text)
    if unknown := re.match(r"Object contains unknown field `(.*)`", message):
        known = part(node, "properties")
        below = [".".join([*keys, name, unknown[1]]) for name, each in known.items()
                 if unknown[1] in part(each, "properties")]  # fmt: skip
        hint = f"; did you mean {' or '.join(map(repr, below))}?" if below else suggestion(unknown[1], known)
        table = place if entries or not keys else f"[{place}]"
        return CaseError(f"{table or 'case'}: unknown key {unknown[1]!r}{hint or '; known are ' + ', '.join(known)}")
    if missing := re.match(r"Object missing required field `(.*)`", message):
        described = part(part(node, "properties")[missing[1]], "description") or "it"
        return CaseError(f"{place}: there is no {missing[1]}; expected {described}")
    expected = part(node, "description") or message.lower().removeprefix("expected ").replace("`", "")
    return CaseError(f"{place} = {literal(value)}; expected {expected}{suggestion(value, part(node, 'enum'))}")


_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{30}}")
"""Dotted keys with more parts than any key of a case: the parser's work and memory grow with their square."""
TABLES = ("grid", "constants", "boundary", "method", "repair")
"""The tables of a case."""


def load(path: Path | None) -> Table:
    """The tables of a case file; empty without a file."""
    if path is None:
        return {}
    require_regular(path, "the case file")
    try:
        # Some Windows editors begin files with a byte order mark.
        return _toml(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CaseError(f"cannot read the case file {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise CaseError(f"{path} is not a TOML file: {error}") from error


def _toml(text: str) -> Table:
    """Parse TOML; ``ValueError`` for anything else."""
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise ValueError(f"line {line}: the key {deep[0][:40]}... has more than 30 parts; expected a key of a case")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None
    except ValueError:
        raise ValueError("it has an integer of more than 64 bits; write large numbers like 1e30") from None


def override(data: Table, text: str) -> tuple[list[str], Any]:
    """Set the value of ``KEY=VALUE`` in ``data``, in place; the names of KEY and the value.

    A value that is not TOML is taken as text. Raises CaseError when there is no ``=`` or no key, or the key passes
    through a value or refers to an entry that does not exist.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise CaseError("expected KEY=VALUE, like method.idw.alpha=0.3")
    try:
        (parsed,) = _toml(f"value = {value}").values()
    except ValueError:
        parsed = value.strip()
        # Numbers, although not in TOML: .1 and 1.
        if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", parsed, re.IGNORECASE):
            parsed = float(parsed)
    path, target = key.strip().split("."), data
    if len(path) == 1 and key.strip() not in TABLES and key.strip() in data.get("constants", {}):
        raise CaseError(f"unknown key {path[0]!r}; did you mean 'constants.{path[0]}'?")
    for name in path[:-1]:
        if isinstance(target, list):
            entries = [(str(e.get("name", n)), str(n), e) for n, e in enumerate(target, 1) if isinstance(e, dict)]
            target = next((entry for known, number, entry in entries if name in (known, number)), None)
            if target is None:
                raise CaseError(f"no entry {name!r}; known are {', '.join(entry[0] for entry in entries) or 'none'}")
        else:
            target = target.setdefault(name, {})
        if not isinstance(target, (dict, list)):
            raise CaseError(f"{name!r} is a value, not a table")
    if isinstance(target, list):
        raise CaseError(
            f'{".".join(path[:-1])} is a list; name an entry and its key, like boundary.wing.kind="fixed", or give '
            "the list as a whole"
        )
    target[path[-1]] = parsed
    return path, parsed
