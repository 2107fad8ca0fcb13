"""CGNS files, HDF5 and ADF."""

from .format import layout, read, variant, write

__all__ = ["layout", "read", "variant", "write"]
