"""The blockMeshDict of OpenFOAM as a block-structured grid."""

from .reader import read_block_mesh

__all__ = ["read_block_mesh"]
