"""Pictures of grids: an image from a depth buffer in matplotlib axes, as png, svg or pdf; films.

``picture`` gives the page that options describe, ``overview`` the default one; ``page_png`` its bytes.
"""

from .colours import Choice
from .comparison import Pair, apart, moved_walls, plane_around, quality_planes, worst_cells
from .facets import Facets, block_facets, cut_facets, joined, plane_facets, surface_facets
from .overview import boundaries, overview
from .page import FILMS, STYLE, SUFFIXES, Page, Panel, check_picture_path, draw, page_figure, page_png, save_page
from .request import PlotOptions, picture
from .subject import METRICS, Subject, worst_cell
from .view import Window, along

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
    "Subject",
    "Window",
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
