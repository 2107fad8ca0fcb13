"""Quality of grids: cells, interfaces, walls, and the verdict on a deformed grid."""

from .original import Original
from .report import Assessment, InvalidCell, Quality, assess

__all__ = ["Assessment", "InvalidCell", "Original", "Quality", "assess"]
