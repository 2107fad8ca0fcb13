"""Boundary conditions of the deformation: classification, motions, constraints."""

from .classification import UNSELECTED, Boundary, BoundarySpec, Kind, classify

__all__ = ["UNSELECTED", "Boundary", "BoundarySpec", "Kind", "classify"]
