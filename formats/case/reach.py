"""Unused content of a case: constants that no formula uses, options of methods that were not chosen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from meshdeform_core.boundary import BoundarySpec
from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.methods import MethodOptions, Options, entry_of

from .forms import Table
from .toml import parsed_override


def unread(data: Table, specs: Sequence[BoundarySpec], options: Options, overrides: Iterable[str]) -> tuple[str, ...]:
    """Warnings about unused content of the case file; an unused ``--set`` is an error.

    Parameters
    ----------
    data : the tables of the case, including the overrides
    overrides : ``KEY=VALUE`` strings

    Raises
    ------
    CaseError
        With the override, the reason, and the nearest name that is used.
    """
    used = _names_used(specs)
    given = [(text, *parsed_override(text)) for text in overrides]
    for text, path, value in given:
        for name in _constants_in(path, value):
            if name not in used:
                others = f"; used are {', '.join(sorted(used))}" if used else "; none uses any"
                known = suggestion(name, used) or others
                raise CaseError(f"--set {text!r}: no formula uses the constant {name!r}{known}")
        if reason := _idle_option(path, options):
            raise CaseError(f"--set {text!r} has no effect: {reason}")
    idle = [name for name in data.get("constants", {}) if name not in used]
    return tuple(f"no formula uses the constant {name!r}{suggestion(name, used)}" for name in idle)


def _names_used(specs: Sequence[BoundarySpec]) -> set[str]:
    """Constants that the formulas use."""
    used: set[str] = set()
    for spec in specs:
        used |= spec.where.names if spec.where else set()
        used |= spec.motion.names if spec.motion else set()
    return used - {"x", "y", "z", "t"}


def _constants_in(path: Sequence[str], value: Any) -> Iterable[str]:
    if path[0] != "constants":
        return ()
    return path[1:2] if len(path) > 1 else value


def _idle_option(path: Sequence[str], options: Options) -> str:
    """Reason why the chosen method does not use an option; empty if it does."""
    if path[0] != "method" or len(path) < 2 or path[1] not in ("idw", "rbf", "tfi"):
        return ""
    own: MethodOptions = getattr(options, path[1])
    used = entry_of(options.name).parts
    if type(own) not in used:
        names = ", ".join(f"method.{kind.__name__.lower()}" for kind in used) or "no options"
        return f"the method {options.name!r} uses only {names}"
    return own.idle.get(path[2], "") if len(path) > 2 else ""
