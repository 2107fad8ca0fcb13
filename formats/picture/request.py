"""A picture as requested by the user: part of the grid, view, and comparison with the undeformed grid."""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Sequence

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.wording import listed

from .comparison import Pair, worst_cells
from .content.end_plane import plane_of_grid
from .content.facets import Facets, block_outlines, cut_facets, plane_facets, plane_outlines, surface_facets
from .content.subject import Subject
from .content.walls import all_walls, corners_of, onto_walls, quads_of
from .content.worst import worst_cell
from .drawing.colours import Scale
from .drawing.image import Scene
from .drawing.page import Page, Panel
from .overview import Choice, flat_scene, overview
from .view import View, Window, along, facing, iso, shaped, window_of

_ARROWS = 20
_GREY = np.array([0.80, 0.81, 0.84])


@dataclasses.dataclass(frozen=True)
class Request:
    """The requested picture; without any options, the default one.

    Attributes
    ----------
    index_plane : index axis and node (0-based, ``None``: the middle)
    space_plane : coordinate axis (``x``, ``y`` or ``z``) and position of a plane through all blocks
    blocks : names of the blocks of an index plane, with wildcards; all if there are none
    select : patterns of patches or block faces, as in a case file
    view : direction of view, ``None`` for a suitable one
    window : part of the picture
    zoom : ``worst``, ``walls`` or nothing
    before : ``side``, ``overlay`` or nothing: draw the undeformed grid too
    arrows : displacements as arrows
    lead : what stands before the names of options in messages
    """

    choice: Choice = dataclasses.field(default_factory=Choice)
    index_plane: tuple[int, int | None] | None = None
    space_plane: tuple[str, float] | None = None
    blocks: tuple[str, ...] = ()
    select: tuple[str, ...] = ()
    view: View | None = None
    window: Window | None = None
    zoom: str = ""
    before: str = ""
    arrows: bool = False
    lead: str = ""

    @property
    def plain(self) -> bool:
        """Whether only the colouring is specified."""
        return dataclasses.replace(self, choice=Choice(), lead="") == Request()


@dataclasses.dataclass(frozen=True)
class _Part:
    """A part of a grid: polygons, block edges, view, whether in space or in a plane; ``quads`` of surfaces."""

    facets: Facets
    outlines: FloatArray
    view: View
    solid: bool
    quads: IntArray | None = None


def picture(subject: Subject, request: Request, title: str = "") -> Page:
    """The page for a request.

    Raises
    ------
    CaseError
        When a plane does not meet the grid, a name matches nothing, or something needs the undeformed grid.
    """
    if (request.before or request.arrows) and subject.reference is None:
        raise CaseError("before and after, and arrows, need the undeformed grid: give --reference")
    if request.plain:
        return overview(subject, request.choice, title)
    if request.zoom == "worst":
        return _worst(subject, request, title)
    part = _part(subject, request)
    view = request.view or part.view
    old = _part(_undeformed(subject), request) if request.before or request.arrows else None
    scale = request.choice.scale(*(p.facets for p in (part, old) if p is not None))
    window = _window(subject, request, part, old, view)
    panel = Panel(_scene(subject, request.choice, scale, part, view), view, window)
    if old is not None and request.arrows:
        panel = dataclasses.replace(panel, arrows=_arrows(old, part, view, window))
    return Page(_beside(subject, request, scale, panel, old), title, scale)


def _beside(subject: Subject, request: Request, scale: Scale, panel: Panel, old: _Part | None) -> tuple[Panel, ...]:
    if old is None or not request.before:
        return (panel,)
    before = _scene(_undeformed(subject), request.choice, scale, old, panel.view)
    if request.before == "overlay":
        grey = dataclasses.replace(before, colours=np.tile(_GREY, (len(before.facets), 1)))
        return (dataclasses.replace(panel, under=grey),)
    return Panel(before, panel.view, panel.window, "before"), dataclasses.replace(panel, title="after")


def _undeformed(subject: Subject) -> Subject:
    """The undeformed grid, with itself as reference so that all metrics have a value."""
    return dataclasses.replace(subject, grid=subject.reference or subject.grid)


def _part(subject: Subject, request: Request) -> _Part:
    metric = request.choice.metric
    if request.select:
        return _selected(subject, request, metric)
    if request.space_plane is not None:
        plane = _space_plane(subject.grid, *request.space_plane, request.lead)
        return _Part(cut_facets(subject, plane, metric), np.empty((0, 2, 3)), facing(plane.normal), False)
    if request.index_plane is not None or request.blocks:
        axis, index = request.index_plane or (2, None)
        blocks = _blocks(subject.grid.names, request)
        facets = plane_facets(subject, axis, index, metric, blocks)
        outlines = plane_outlines(subject, axis, index, blocks)
        return _Part(facets, outlines, *_view_of(facets))
    flat = plane_of_grid(subject, metric)
    if flat is not None:
        return _Part(*flat, False)
    walls = all_walls(subject)
    quads = quads_of(walls) if walls else np.flatnonzero(subject.topology.external)
    return _surface(subject, quads, metric, onto_walls(subject) if walls else iso())


def _blocks(names: Sequence[str], request: Request) -> tuple[int, ...] | None:
    """Numbers of the blocks whose names match the patterns; ``None`` means all."""
    found: list[int] = []
    for pattern in request.blocks:
        matching = [n for n, name in enumerate(names) if fnmatch.fnmatchcase(name, pattern)]
        if not matching:
            raise CaseError(f"{request.lead}block {pattern!r} matches no block; blocks are {listed(names)}")
        found += matching
    return tuple(dict.fromkeys(found)) or None


def _space_plane(grid: Grid, axis: str, at: float, lead: str) -> Plane:
    """The plane on which the coordinate ``axis`` is ``at``."""
    number = "xyz".index(axis)
    if grid.dimension == 2:
        raise CaseError(f"a 2-D grid cannot be cut; leave {lead}plane out to draw the whole grid")
    lowest, highest = extent(grid.points)
    low, high, tiny = lowest[number], highest[number], 1e-9 * float((highest - lowest).max())
    if not low - tiny <= at <= high + tiny:
        raise CaseError(f"no part of the grid lies at {axis} = {at:g}; it spans {axis} = {low:.6g} to {high:.6g}")
    normal = np.eye(3)[number]
    return Plane(at * normal, normal)


def _selected(subject: Subject, request: Request, metric: str) -> _Part:
    if subject.grid.dimension == 2:
        raise CaseError("a 2-D grid has no surfaces to select; leave --select out to draw the whole grid")
    quads = select_quads(subject.reference or subject.grid, subject.topology, request.select, "plot")
    return _surface(subject, quads, metric, onto_walls(subject))


def _surface(subject: Subject, quads: IntArray, metric: str, view: View) -> _Part:
    facets = surface_facets(subject, quads, metric)
    view, solid = (view, True) if _view_of(facets)[1] else _view_of(facets)
    return _Part(facets, block_outlines(subject.grid, subject.topology, quads), view, solid, quads)


def _view_of(facets: Facets) -> tuple[View, bool]:
    """The view of polygons, and whether they are not flat along an axis."""
    size = np.ptp(facets.corners.reshape(-1, 3), axis=0)
    axis = int(np.argmin(size))
    if size[axis] <= 1e-6 * size.max():
        return along("xyz"[axis]), False
    return iso(), True


def _scene(subject: Subject, choice: Choice, scale: Scale, part: _Part, view: View) -> Scene:
    if not part.solid:
        return flat_scene(subject, choice, scale, part.facets, part.outlines, view)
    return Scene(part.facets, scale.colours(part.facets), part.outlines, lit=True, lines=choice.lines)


def _window(subject: Subject, request: Request, part: _Part, old: _Part | None, view: View) -> Window:
    if request.window:
        return request.window
    corners = np.concatenate([p.facets.corners.reshape(-1, 3) for p in (part, old) if p is not None])
    if request.zoom == "walls":
        walls = all_walls(subject)
        if not walls:
            raise CaseError(f"{request.lead}zoom walls: no wall is known; see `meshdeform info`")
        return shaped(window_of(view, corners_of(subject, walls), 0.3), (0.4, 1.2))
    return shaped(window_of(view, corners, 0.03), (0.05, 1.4))


def _worst(subject: Subject, request: Request, title: str) -> Page:
    block, cell = worst_cell(subject, request.choice.metric)
    pair = Pair(subject.reference or subject.grid, subject.grid, subject.topology)
    page = worst_cells(pair, block, cell, request.choice)
    after = dataclasses.replace(page.panels[1], title=f"worst cell: {subject.grid.label(block, cell)}")
    if subject.reference is None:
        return dataclasses.replace(page, panels=(after,), title=title)
    return dataclasses.replace(page, panels=(page.panels[0], after), title=title)


def _arrows(old: _Part, new: _Part, view: View, window: Window) -> FloatArray:
    """Arrows (k, 2, 3), undeformed position and displacement, of polygons spread over the picture."""
    if len(old.facets) != len(new.facets):
        raise CaseError("arrows need a plane of nodes, a surface or a flat grid; a cut in space has no cells in common")
    start, end = old.facets.corners[:, 0], new.facets.corners[:, 0]
    left, right, bottom, top = window
    at = view.project(start)[:, :2]
    step = (right - left) / _ARROWS
    cell = np.floor((at - (left, bottom)) / step).astype(np.int64)
    inside = ((at >= (left, bottom)) & (at <= (right, top))).all(axis=1)
    _, first = np.unique(cell[inside, 0] * 10_000 + cell[inside, 1], return_index=True)
    chosen = np.flatnonzero(inside)[first]
    return np.stack([start[chosen], (end - start)[chosen]], axis=1)
