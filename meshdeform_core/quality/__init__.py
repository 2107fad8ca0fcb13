"""Quality of grids: cells, interfaces, walls, and the verdict on a deformed grid."""

from .report import Assessment, InvalidCell, Quality, assess

__all__ = ["Assessment", "InvalidCell", "Quality", "assess"]
