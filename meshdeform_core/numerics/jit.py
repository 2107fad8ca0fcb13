"""How loops are compiled: cached on disk, without the interpreter lock, with numpy's rules for division.

Numpy's error model matters for speed: Python's would test every division for zero, which keeps loops scalar.
"""

from numba import njit

kernel = njit(cache=True, nogil=True, error_model="numpy")
"""Decorator for loops whose results must not depend on the order of operations."""

fast_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
"""Decorator for sums: additions may be reordered, so that they become vector instructions."""

contracted_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
"""Decorator for functions that may fuse multiplications with additions but must keep their order."""

inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
"""Decorator for parts of a loop: the compiler sees them in their place, with the arrays of the caller."""
