"""The topology of a grid: coincident nodes, shared and outside faces, handedness of blocks."""

from .handedness import block_handedness
from .topology import (
    RELATIVE_TOLERANCE,
    FaceQuads,
    Topology,
    cells_behind,
    find_topology,
    inward_step,
    side_nodes,
)

__all__ = [
    "RELATIVE_TOLERANCE",
    "FaceQuads",
    "Topology",
    "block_handedness",
    "cells_behind",
    "find_topology",
    "inward_step",
    "side_nodes",
]
