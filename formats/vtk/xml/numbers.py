"""Numbers in the text of a VTK XML file."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray


class NotANumber(Exception):
    """Something in a text is not a number of the expected type; the message quotes it."""


def numbers_in_text(text: bytes, dtype: np.dtype[Any]) -> NDArray[Any]:
    """All numbers of a text between white space, in ``dtype``.

    Raises
    ------
    NotANumber
        When something is not a number, or exceeds the type.
    """
    if not text.strip():
        return np.empty(0, dtype)
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            values = _parsed(text, np.dtype("f8")).astype(dtype, copy=False)
        if np.isinf(values).any() and b"inf" not in text.lower():
            raise NotANumber("a number out of range")
        return values
    numbers = _parsed(text, np.dtype("i8"))
    limits, wide = np.iinfo(dtype), np.iinfo(numbers.dtype)
    # The parser saturates at the limits of 64 bits; a number there may be anything beyond.
    if numbers.max() == wide.max or numbers.min() == wide.min:
        return _exact(text, dtype)
    wrong = np.flatnonzero((numbers < limits.min) | (numbers > limits.max))
    if wrong.size:
        raise NotANumber(f"{numbers[wrong[0]]}")
    return numbers.astype(dtype)


def _parsed(text: bytes, dtype: np.dtype[Any]) -> NDArray[Any]:
    with warnings.catch_warnings():
        # numpy before 2.3 warns where later versions raise.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise NotANumber(_first_stranger(text, dtype)) from error


def _exact(text: bytes, dtype: np.dtype[Any]) -> NDArray[Any]:
    limits = np.iinfo(dtype)
    values = []
    for word in text.split():
        try:
            value = int(word)
        except ValueError as error:
            raise NotANumber(_shown(word)) from error
        if not limits.min <= value <= limits.max:
            raise NotANumber(_shown(word))
        values.append(value)
    return np.array(values, dtype)


def _first_stranger(text: bytes, dtype: np.dtype[Any]) -> str:
    number = float if dtype.kind == "f" else int
    for word in text.split():
        try:
            number(word)
        except ValueError:
            return _shown(word)
    return "something that is not a number"


def _shown(word: bytes) -> str:
    return repr(word[:40].decode("utf-8", "replace"))
