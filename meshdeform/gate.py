"""Checks of arrays where they enter the program: shape, type, finiteness. Nothing below checks them again."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary.motions.motion import LARGEST
from meshdeform_core.errors import GridError, MeshDeformError, MotionError
from meshdeform_core.grid import FloatArray
from meshdeform_core.parallel import WholeGridNeeded

_NUMBERS = "iuf"


@contextmanager
def in_parts() -> Iterator[None]:
    """Convert the error of an operation that a grid in parts does not allow into one for users, on all ranks alike.

    Raises
    ------
    GridError
        With the reason.
    """
    try:
        yield
    except WholeGridNeeded as reason:
        raise GridError(
            f"{reason}: that takes the whole grid on every rank, which holds a part; expected a grid prepared without "
            f"comm=, or gathered by Grid.gathered()"
        ) from None


def checked_array(
    values: ArrayLike, shape: Sequence[int | None], what: str, meaning: str, error: type[MeshDeformError]
) -> FloatArray:
    """``values`` as a new C-contiguous float64 array.

    Parameters
    ----------
    shape : expected extents; ``None`` where any extent is accepted
    what, meaning : name of the array and meaning of its rows, for messages

    Raises
    ------
    error
        When it is not an array of real numbers, carries a unit, has the wrong shape, or contains values that are not
        finite or too large for any grid.
    """
    expected = f"expected ({', '.join('n' if n is None else str(n) for n in shape)}): {meaning}"
    # Arrays of other packages lose their unit by conversion.
    unit = getattr(values, "units", getattr(values, "unit", None))
    if unit is not None and not callable(unit) and str(unit):
        raise error(f"{what} has the unit {str(unit)!r}; expected plain numbers in the length unit of the grid")
    try:
        array = np.asanyarray(values)
    except ValueError as failure:
        raise error(f"{what} is not an array ({failure}); {expected}") from None
    if isinstance(array, np.ma.MaskedArray) and np.ma.is_masked(array):
        raise error(f"{what} has {int(np.ma.count_masked(array))} masked values; {expected}, none of them missing")
    if array.dtype.kind not in _NUMBERS:
        raise error(f"{what} has the type {array.dtype}; expected real numbers, {expected[9:]}")
    fits = len(array.shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        raise error(f"{what} has the shape {array.shape}; {expected}")
    result: FloatArray = np.array(array, dtype=np.float64, order="C")
    finite = np.isfinite(result)
    if not finite.all():
        at = tuple(int(n) for n in np.argwhere(~finite)[0])
        raise error(
            f"{what} has {int((~finite).sum())} values that are not finite, the first is {result[at]} at index "
            f"{list(at)}; expected finite numbers"
        )
    largest = float(np.abs(result).max(initial=0.0))
    if largest > LARGEST:
        raise error(f"{what} has values up to {largest:.3g}; expected lengths up to {LARGEST:g}")
    return result


def checked_time(value: Any, error: type[MeshDeformError]) -> float:
    """A time as a number.

    Raises
    ------
    error
        When it is not a finite number.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise error(f"time = {value!r}; expected a finite number")
    return float(value)


def whole_number(value: Any) -> Any:
    """An integer of any type, such as numpy's, as ``int``; anything else is returned unchanged."""
    return int(value) if isinstance(value, numbers.Integral) and not isinstance(value, bool) else value


def require_arguments(function: Callable[..., Any], what: str, *names: str) -> None:
    """Refuse a function that cannot be called with as many arguments as there are ``names``.

    Raises
    ------
    MotionError
        Stating the arguments that it has and those expected.
    """
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        # Some compiled functions have no signature.
        return
    try:
        signature.bind(*names)
    except TypeError:
        raise MotionError(f"{what} is a function{signature}; expected one of ({', '.join(names)})") from None
