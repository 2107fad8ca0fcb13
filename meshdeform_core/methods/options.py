"""Option values: defaults with reasons, and checks."""

from __future__ import annotations

from dataclasses import Field, field, fields
from typing import Any

import numpy as np

from ..errors import MethodError
from ..wording import literal
from .base import Setting


def option(default: Any, why: str) -> Any:
    """A dataclass field for an option; ``why`` is a short reason for the default."""
    return field(default=default, metadata={"why": why})


def reason_of(parameter: Field[Any]) -> str:
    """The reason for an option's default."""
    return str(parameter.metadata["why"])


def used(options: Any, *names: str) -> dict[str, Setting]:
    """The named options with their values and the reasons for them."""
    known = {parameter.name: parameter for parameter in fields(options)}
    settings = {}
    for name in names:
        value = getattr(options, name)
        chosen = value != known[name].default
        settings[name] = Setting(value, "given" if chosen else f"default: {reason_of(known[name])}")
    return settings


def choose(name: str, value: Any, known: tuple[Any, ...]) -> None:
    """Refuse a value that is not one of ``known``."""
    if not any(value == k and type(value) is type(k) for k in known):
        raise MethodError(f"method.{name} = {literal(value)} is unknown; known are {', '.join(str(k) for k in known)}")


def positive(
    name: str, value: Any, *, auto: bool = False, whole: bool = False, zero: bool = False, most: float = np.inf
) -> None:
    """Refuse anything but a positive finite number up to ``most`` (or 0 with ``zero``, or ``"auto"`` with ``auto``)."""
    if auto and value == "auto":
        return
    number = isinstance(value, int) or (isinstance(value, float) and not whole)
    if isinstance(value, bool) or not number or not np.isfinite(value) or value < 0 or (value == 0 and not zero):
        kind = "whole number" if whole else "number"
        expected = f"a {kind} >= 0" if zero else f"a positive {kind}"
        alternative = ' or "auto"' if auto else ""
        raise MethodError(f"method.{name} = {literal(value)}; expected {expected}{alternative}")
    if value > most:
        raise MethodError(f"method.{name} = {literal(value)}; expected at most {most:g}, beyond which powers overflow")
