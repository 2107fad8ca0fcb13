"""VTK files: legacy .vtk, .vts and .vtm."""

from .format import read, variant, write

__all__ = ["read", "variant", "write"]
