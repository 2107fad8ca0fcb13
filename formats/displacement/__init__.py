"""Displacement tables."""

from .reader import read_displacement, write_displacement

__all__ = ["read_displacement", "write_displacement"]
