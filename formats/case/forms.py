"""How the content of a case file is declared, and its errors: what was found and expected, where, the nearest key.

A table of a case is declared by a :class:`Form`, whose fields have types, ranges and descriptions; msgspec converts,
and derives the JSON schema.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from meshdeform_core.boundary.motions.expression import Expression, expression
from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.wording import literal

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


def fail(where: str, message: str) -> CaseError:
    """The error to raise for the content at ``where``."""
    return CaseError(f"{where}: {message}")


def formula_of(value: Any, known: Iterable[str], where: str) -> Expression:
    """A number or a formula of the names in ``known``."""
    try:
        return expression(value, known)
    except CaseError as error:
        raise fail(where, str(error)) from None


def plain(value: Any, depth: int = 0) -> Any:
    """Tables made in Python, converted to the types of TOML: dictionaries, lists, numbers, texts."""
    if depth > _DEEPEST:
        raise CaseError(f"its tables are nested more than {_DEEPEST} deep; expected a case like that of a case file")
    if isinstance(value, Mapping):
        return {key: plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, depth + 1) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def filled(form: type[Of], value: Any, where: str = "") -> Of:
    """The content ``value`` at ``where`` as a form.

    Raises CaseError with the place, what was found and expected, and for unknown keys the nearest known one.
    """
    if (path := _not_finite(value)) is not None:
        place = _Place(form, value, where, path)
        for key in path:
            value = value[key]
        raise place.error(f"expected a finite number, found {literal(value)}")
    try:
        return msgspec.convert(value, form)
    except msgspec.ValidationError as error:
        message, _, path_text = str(error).partition(" - at `$")
        names = [name or int(number) for name, number in re.findall(r"\.([\w-]+)|\[(\d+)\]", path_text)]
        raise _Place(form, value, where, names).explained(message) from None


def schema_of(form: type[Form]) -> Table:
    """The JSON schema of a form."""
    return msgspec.json.schema(form)


def _not_finite(value: Any) -> list[str | int] | None:
    """Where a number that is not finite is."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            if (path := _not_finite(item)) is not None:
                return [key, *path]
        return None
    return [] if isinstance(value, float) and not abs(value) < float("inf") else None


class _Place:
    """A place in the content of a form, in words: ``boundary 'body', motion step 1, rotate``, and a key there."""

    def __init__(self, form: type[Form], value: Any, where: str, path: list[str | int]):
        self._definitions = schema_of(form)["$defs"]
        self.tables, self.key, self.found = ([where] if where else []), "", value
        self.node, self._dotted = self._dereferenced(schema_of(form)), True
        for step in path:
            if isinstance(step, str):
                self._enter()
                self.key, self.found = step, self.found[step]
                self.node = self._dereferenced(self._alternative("properties")["properties"].get(step, {}))
            elif isinstance(self.found[step], dict):
                own = self.found[step]
                name = f"boundary {literal(own.get('name', f'boundary {step + 1}'))}"
                labels = {"boundary": name, "motion": f"motion step {step + 1}"}
                self.tables.append(labels.get(self.key, f"{self.key} {step + 1}"))
                self.key, self.found, self._dotted = "", own, False
                self.node = self._dereferenced(self._alternative("items")["items"])
            else:
                # A list of numbers or names is shown as a whole.
                break

    def _enter(self) -> None:
        if self.key:
            # A single motion may stand without its list.
            motion = self.key == "motion"
            self.tables.append("motion step 1" if motion else self.key)
            self.key, self._dotted = "", self._dotted and not motion

    def _dereferenced(self, node: Table) -> Table:
        own = self._definitions[node["$ref"].rpartition("/")[2]] if "$ref" in node else {}
        return {**own, **node}

    def _alternative(self, what: str) -> Table:
        """The table, or the list, that the place may hold."""
        nodes = [self.node, *map(self._dereferenced, self.node.get("anyOf", ()))]
        return next((node for node in nodes if what in node), {"properties": {}, "items": {}})

    def error(self, message: str) -> CaseError:
        """The error with a message about the key."""
        if self._dotted:
            return fail(".".join([*self.tables, self.key]), message)
        return fail(", ".join(self.tables), f"{self.key}: {message}" if self.key else message)

    def explained(self, message: str) -> CaseError:
        """The error for a message of msgspec."""
        if found := re.match(r"Object contains unknown field `(.*)`", message):
            self._enter()
            known = list(self._alternative("properties")["properties"])
            hint = suggestion(found[1], known) or f"; known are {', '.join(known)}"
            top = f"[{'.'.join(self.tables)}]" if self.tables else "case"
            return fail(top if self._dotted else ", ".join(self.tables), f"unknown key {found[1]!r}{hint}")
        if found := re.match(r"Object missing required field `(.*)`", message):
            self._enter()
            node = self._dereferenced(self._alternative("properties")["properties"][found[1]])
            return self.error(f"there is no {found[1]}; expected {node.get('description', 'it')}")
        if not re.match("Expected |Invalid ", message):
            self._enter()
            return self.error(message)
        expected = self.node.get("description", message.lower().removeprefix("expected ").replace("`", ""))
        value = f"{literal(self.found)}; expected {expected}"
        if self._dotted:
            return CaseError(f"{'.'.join([*self.tables, self.key])} = {value}")
        return fail(", ".join(self.tables), f"{self.key} = {value}" if self.key else f"found {value}")
