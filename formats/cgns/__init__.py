"""CGNS files, HDF5 and ADF."""

from .format import read, variant, write

__all__ = ["read", "variant", "write"]
