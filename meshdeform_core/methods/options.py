"""Options of methods, each declared once: its type, default and reason, its range, and when it has an effect.

Checks, the JSON schema, ``meshdeform methods NAME`` and the refusal of options without effect follow from the
declaration: a field of a frozen dataclass that inherits from :class:`MethodOptions`, like
``alpha: float | Literal["auto"] = option(0.1, "why", range="(0, 1e4]", only_if={"weights": ("luke",)})``.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ..errors import MethodError, suggestion
from ..wording import literal
from .base import Setting


def option(
    default: Any, why: str, *, range: str = "(0, inf)", only_if: Mapping[str, tuple[Any, ...]] | None = None
) -> Any:
    """A dataclass field for an option: ``why`` is a short reason for the default, ``range`` the interval of a number,
    like ``"(0, 1]"``, ``only_if`` has the values of other options without which it has no effect."""
    return field(default=default, metadata={"why": why, "range": range, "only_if": only_if or {}})


@dataclass(frozen=True)
class Option:
    """The declaration of an option: ``meaning`` is from the docstring of its class, ``choices`` are texts and truth
    values that it may have, ``number`` is ``int`` or ``float`` if it may be a number, which is at most ``high`` and at
    least ``low``, or above it if ``open_low``."""

    name: str
    default: Any
    why: str
    meaning: str
    choices: tuple[Any, ...]
    number: type | None
    low: float
    high: float
    open_low: bool
    only_if: Mapping[str, tuple[Any, ...]]

    def accepts(self, value: Any) -> bool:
        """Whether the option may have a value."""
        if any(value == choice and type(value) is type(choice) for choice in self.choices):
            return True
        kinds = int if self.number is int else (int, float)
        if self.number is None or isinstance(value, bool) or not isinstance(value, kinds):
            return False
        above = value > self.low if self.open_low else value >= self.low
        return above and value <= self.high and value < float("inf")

    @property
    def expected(self) -> str:
        """The values that it may have, for messages."""
        choices = " or ".join(literal(choice).replace("'", '"') for choice in self.choices)
        if self.number is None:
            return choices
        number = "whole number" if self.number is int else "number"
        text = f"a positive {number}" if self.open_low and self.low == 0 else f"a {number} >= {self.low:g}"
        text += f" up to {self.high:g}" if self.high < float("inf") else ""
        return f"{text} or {choices}" if choices else text


def _declared(kind: type) -> Mapping[str, Option]:
    """The options of a class by name."""
    hints = get_type_hints(kind)
    meanings: dict[str, str] = {}
    for each_class in reversed(kind.__mro__):
        # The entries of the section ``Attributes``, without markup.
        text = inspect.cleandoc(each_class.__doc__ or "").partition("Attributes\n----------\n")[2]
        for entry in re.split(r"\n(?=\w)", text):
            names, _, meaning = entry.partition(" : ")
            meanings |= dict.fromkeys(names.split(", "), " ".join(meaning.replace("``", "").split()))
    found = {}
    for each in fields(kind):
        hint = hints[each.name]
        parts = (hint,) if get_origin(hint) is Literal else get_args(hint) or (hint,)
        choices = [choice for part in parts if get_origin(part) is Literal for choice in get_args(part)]
        choices += [True, False] if bool in parts else []
        interval = each.metadata["range"]
        low, high = (float(end) for end in interval[1:-1].split(","))
        found[each.name] = Option(
            each.name, each.default, each.metadata["why"], meanings[each.name], tuple(choices),
            next((part for part in parts if part in (int, float)), None), low, high, interval[0] == "(",
            each.metadata["only_if"],
        )  # fmt: skip
    return found


declared: Callable[[type], Mapping[str, Option]] = functools.cache(_declared)


class MethodOptions:
    """Options of an elementary method, all of them checked."""

    def __post_init__(self) -> None:
        """Refuse values that an option may not have."""
        for name, each in declared(type(self)).items():
            value = getattr(self, name)
            if not each.accepts(value):
                place = f"method.{type(self).__name__.lower()}.{name} = {literal(value)}"
                if each.number is None:
                    known = [literal(choice).strip("'") for choice in each.choices]
                    raise MethodError(f"{place} is unknown; known are {', '.join(known)}{suggestion(value, known)}")
                raise MethodError(f"{place}; expected {each.expected}")

    @property
    def idle(self) -> dict[str, str]:
        """Options that have no effect in combination with the others, and why."""
        idle = {}
        for name, each in declared(type(self)).items():
            for other, values in each.only_if.items():
                if getattr(self, other) not in values:
                    wanted = " or ".join(literal(value).replace("'", '"') for value in values)
                    idle[name] = f"it is only used with method.{type(self).__name__.lower()}.{other} = {wanted}"
        return idle

    def used(self, *names: str) -> dict[str, Setting]:
        """The named options with their values and the reasons for them."""
        known = declared(type(self))
        values = {name: getattr(self, name) for name in names}
        return {
            name: Setting(value, "given" if value != known[name].default else f"default: {known[name].why}")
            for name, value in values.items()
        }
