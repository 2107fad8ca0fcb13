"""OpenFOAM: blockMeshDict files."""

from .format import read

__all__ = ["read"]
