"""Quality of grids: cells, interfaces, walls, and the verdict on a deformed grid."""

from .per_block import BlockQuality, BlockSkew
from .report import Assessment, InvalidCell, Quality, assess
from .verdict.original import Original

__all__ = ["Assessment", "BlockQuality", "BlockSkew", "InvalidCell", "Original", "Quality", "assess"]
