"""Grids: blocks of nodes, and the topology that follows from their coordinates."""

from ..numerics.arrays import BoolArray, FloatArray, IntArray
from .blocks import Grid
from .parts import Connection, Field, FileFormat, OwnPlanes, Patch, Periodicity, Planes, Shape, Side, Window

__all__ = [
    "BoolArray",
    "Connection",
    "Field",
    "FileFormat",
    "FloatArray",
    "Grid",
    "IntArray",
    "OwnPlanes",
    "Patch",
    "Periodicity",
    "Planes",
    "Shape",
    "Side",
    "Window",
]
