"""Gather and scatter rows of displacement arrays (n, 3) by index, without temporary arrays."""

from .jit import kernel


@kernel
def take_rows(values, rows, out):
    """``out[n] = values[rows[n]]``."""
    for n in range(rows.size):
        for c in range(3):
            out[n, c] = values[rows[n], c]


@kernel
def put_rows(values, rows, out):
    """``out[rows[n]] = values[n]``."""
    for n in range(rows.size):
        for c in range(3):
            out[rows[n], c] = values[n, c]


@kernel
def spread_rows(values, numbers, rows, out):
    """``out[rows[n]] = values[numbers[n]]``."""
    for n in range(rows.size):
        for c in range(3):
            out[rows[n], c] = values[numbers[n], c]


@kernel
def collect_rows(values, numbers, rows, out):
    """Transpose of :func:`spread_rows`: ``out[numbers[n]] += values[rows[n]]``, then ``values[rows[n]] = 0``."""
    for n in range(rows.size):
        for c in range(3):
            out[numbers[n], c] += values[rows[n], c]
            values[rows[n], c] = 0.0


@kernel
def project_rows(values, rows, removed):
    """``values[r] -= values[r] @ removed`` for the given rows, each once; ``removed`` (3, 3)."""
    for r in rows:
        x, y, z = values[r, 0], values[r, 1], values[r, 2]
        for c in range(3):
            values[r, c] -= x * removed[0, c] + y * removed[1, c] + z * removed[2, c]
