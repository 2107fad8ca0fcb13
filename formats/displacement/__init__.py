"""Displacement tables."""

from .table import read_displacement, write_displacement

__all__ = ["read_displacement", "write_displacement"]
