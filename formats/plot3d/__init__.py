"""Plot3D files, all variants."""

from .format import read, variant, write

__all__ = ["read", "variant", "write"]
