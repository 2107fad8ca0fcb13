"""Which nodes a repair may move, and the cells around them: regions, distances from walls, and shares of the ranks."""

from .regions import Neighbourhood, Plot

__all__ = ["Neighbourhood", "Plot"]
