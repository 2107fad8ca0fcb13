"""Checks of option values: one message with the key, what was found and what was expected."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import MethodError


def choose(name: str, value: Any, known: tuple[Any, ...]) -> None:
    """Refuse a value that is not one of ``known``."""
    if not any(value == k and type(value) is type(k) for k in known):
        raise MethodError(f"method.{name} = {value!r} is unknown; known are {', '.join(str(k) for k in known)}")


def positive(name: str, value: Any, *, auto: bool = False, whole: bool = False, zero: bool = False) -> None:
    """Refuse anything but a positive finite number (or 0 with ``zero``, or ``"auto"`` with ``auto``)."""
    if auto and value == "auto":
        return
    number = isinstance(value, int) or (isinstance(value, float) and not whole)
    if isinstance(value, bool) or not number or not np.isfinite(value) or value < 0 or (value == 0 and not zero):
        kind = "whole number" if whole else "number"
        expected = f"a {kind} >= 0" if zero else f"a positive {kind}"
        alternative = ' or "auto"' if auto else ""
        raise MethodError(f"method.{name} = {value!r}; expected {expected}{alternative}")
