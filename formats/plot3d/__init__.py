"""Plot3D files, all variants."""

from .format import layout, read, variant, write

__all__ = ["layout", "read", "variant", "write"]
