"""Pictures of grids: an image from a depth buffer in matplotlib axes, as png, svg or pdf.

``overview`` is the default picture of a grid; ``page_png`` gives the bytes of a page of panels.
"""

from .boundaries import boundaries
from .comparison import Pair, apart, moved_walls, plane_around, quality_planes, worst_cells
from .content.facets import Facets, block_facets, cut_facets, joined, plane_facets, surface_facets
from .content.subject import METRICS, Subject
from .content.worst import worst_cell
from .drawing.figure import FILMS, STYLE, SUFFIXES, check_picture_path, page_figure, page_png, save_page
from .drawing.page import Page, Panel
from .drawing.vector import draw
from .overview import Choice, overview
from .plot_options import PlotOptions
from .request import Request, picture
from .view import along

__all__ = [
    "FILMS",
    "METRICS",
    "STYLE",
    "SUFFIXES",
    "Choice",
    "Facets",
    "Page",
    "Pair",
    "Panel",
    "PlotOptions",
    "Request",
    "Subject",
    "along",
    "apart",
    "block_facets",
    "boundaries",
    "check_picture_path",
    "cut_facets",
    "draw",
    "joined",
    "moved_walls",
    "overview",
    "page_figure",
    "page_png",
    "picture",
    "plane_around",
    "plane_facets",
    "quality_planes",
    "save_page",
    "surface_facets",
    "worst_cell",
    "worst_cells",
]
