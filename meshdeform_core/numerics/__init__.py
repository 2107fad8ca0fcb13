"""Numba loops and linear algebra on plain arrays; no knowledge of grids."""
