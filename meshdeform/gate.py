"""Where arrays enter: shape, type and finiteness are checked once; nothing below checks again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.errors import MeshDeformError
from meshdeform_core.grid import FloatArray

_NUMBERS = "iuf"


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
        When it is not an array of real numbers, has the wrong shape, or contains non-finite values.
    """
    expected = f"expected ({', '.join('n' if n is None else str(n) for n in shape)}): {meaning}"
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
    _require_finite(result, what, error)
    return result


def _require_finite(array: FloatArray, what: str, error: type[MeshDeformError]) -> None:
    finite = np.isfinite(array)
    if not finite.all():
        at = tuple(int(n) for n in np.argwhere(~finite)[0])
        raise error(
            f"{what} has {int((~finite).sum())} values that are not finite, the first is {array[at]} at index "
            f"{list(at)}; expected finite numbers"
        )
