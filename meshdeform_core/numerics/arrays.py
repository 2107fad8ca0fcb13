"""Types of arrays, and of what reports progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KeyArray = NDArray[np.uint64]
BoolArray = NDArray[np.bool_]

Shapes = Sequence[tuple[int, int, int]] | IntArray
"""Numbers of nodes along i, j, k of blocks."""
Report = Callable[[int, int], None]
"""``report(done, total)``, called while a loop runs."""
