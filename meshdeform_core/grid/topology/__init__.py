"""The topology of a grid: coincident nodes, shared and outside faces, handedness of blocks."""

from .declared_faces import find_topology, is_wall, quads_of_patches, quads_of_windows, separated
from .handedness import block_handedness
from .topology import RELATIVE_TOLERANCE, FaceQuads, Topology, cells_behind, inward_step, side_nodes

__all__ = [
    "RELATIVE_TOLERANCE",
    "FaceQuads",
    "Topology",
    "block_handedness",
    "cells_behind",
    "find_topology",
    "inward_step",
    "is_wall",
    "quads_of_patches",
    "quads_of_windows",
    "separated",
    "side_nodes",
]
