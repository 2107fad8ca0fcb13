"""Grids: blocks of nodes, and what their coordinates say about which nodes and faces belong together."""

from ..numerics.arrays import BoolArray, FloatArray, IntArray
from .blocks import (
    Connection,
    Field,
    FileFormat,
    Grid,
    Patch,
    Periodicity,
    Shape,
    Side,
    Window,
)

__all__ = [
    "BoolArray",
    "Connection",
    "Field",
    "FileFormat",
    "FloatArray",
    "Grid",
    "IntArray",
    "Patch",
    "Periodicity",
    "Shape",
    "Side",
    "Window",
]
