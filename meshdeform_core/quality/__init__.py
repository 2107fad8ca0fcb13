"""Quality of grids: cells, interfaces, walls, and the verdict on a deformed grid."""

from .original import Original
from .report import Assessment, BlockQuality, BlockSkew, InvalidCell, Quality, assess

__all__ = ["Assessment", "BlockQuality", "BlockSkew", "InvalidCell", "Original", "Quality", "assess"]
