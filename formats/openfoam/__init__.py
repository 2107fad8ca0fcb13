"""OpenFOAM: blockMeshDict files, cases, and meshes (polyMesh)."""

from .format import read, variant, write

__all__ = ["read", "variant", "write"]
