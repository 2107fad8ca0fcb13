"""Where the derivatives of cells are added to a block-sparse matrix."""

from __future__ import annotations

from ...jit import inlined


@inlined
def place_of(row, column, rows):
    """Where the block of a row and a column is, -1 if the row is not one of ``rows``."""
    first, last, starts, columns = rows
    if row < first or row >= last:
        return -1
    return _find(columns, starts[row], starts[row + 1], column) - starts[first]


@inlined
def _find(columns, low, high, wanted):
    """Position of ``wanted`` in the ascending ``columns[low:high]``."""
    while high - low > 1:
        middle = (low + high) // 2
        if columns[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low
