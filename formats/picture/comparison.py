"""Before and after: the walls that moved, the worst cells close up, a plane coloured by quality."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from meshdeform_core.grid import FloatArray, Grid, IntArray, Shape
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.topology import Topology
from meshdeform_core.quality import Original

from .content.end_plane import is_flat, plane_of_grid
from .content.facets import Facets, block_facets, block_outlines, cut_facets, joined, surface_facets
from .content.subject import Subject
from .content.walls import body_walls, middle_plane, nodes_of, onto_walls
from .drawing.image import Scene
from .drawing.page import Page, Panel
from .overview import Choice, flat_scene, moved_into
from .view import View, Window, facing, shaped, window_of

_GREY = np.array([0.72, 0.74, 0.78])
_AROUND = 7
"""Number of cells that a close-up shows on either side of the worst one."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """A grid before and after, with the topology of the undeformed one.

    ``undeformed`` is the grid that both are judged against, if it differs from the one before; ``original`` are its
    cells and faces, if these have been found already.
    """

    before: Grid
    after: Grid
    topology: Topology
    undeformed: Grid | None = None
    original: Original | None = None

    @cached_property
    def old(self) -> Subject:
        return Subject(self.before, self.topology, self.undeformed, original=self.original)

    @cached_property
    def new(self) -> Subject:
        return Subject(self.after, self.topology, self.undeformed or self.before, original=self.old)


def moved_walls(pair: Pair, quads: IntArray) -> Page:
    """The moving walls before and after, in the same view, coloured by displacement.

    Parameters
    ----------
    quads : the moving face quads of a 3-D grid; for a 2-D or extruded grid the plane around them is shown
    """
    old, new = pair.old, pair.new
    if is_flat(old):
        return _flat_walls(pair, quads)
    choice = Choice("displacement")
    view = onto_walls(old)
    before, after = surface_facets(old, quads), _displaced(new, quads)
    scale = choice.scale(after)
    window = shaped(window_of(view, np.concatenate([before.corners, after.corners]), 0.06), (0.6, 1.0))
    panels = []
    for facets, colours, grid, name in (
        (before, np.tile(_GREY, (len(before), 1)), pair.before, "before"),
        (after, scale.colours(after), pair.after, "after"),
    ):
        scene = Scene(facets, colours, block_outlines(grid, pair.topology, quads), lit=True)
        panels.append(Panel(scene, view, window, name))
    return Page(tuple(panels), "", scale)


def _displaced(subject: Subject, quads: IntArray) -> Facets:
    """Facets of the face quads, coloured by the mean displacement of their corners."""
    facets = surface_facets(subject, quads)
    assert subject.reference is not None
    before = surface_facets(dataclasses.replace(subject, grid=subject.reference, reference=None), quads)
    moved = np.linalg.norm(facets.corners - before.corners, axis=2).mean(axis=1)
    return dataclasses.replace(facets, values=moved)


def _flat_walls(pair: Pair, quads: IntArray) -> Page:
    choice = Choice()
    nodes = pair.topology.first[np.unique(pair.topology.quads.corners[quads])]
    planes = [plane_of_grid(subject, choice.metric) for subject in (pair.old, pair.new)]
    found = [plane for plane in planes if plane is not None]
    view = found[0][2]
    points = np.concatenate([pair.before.points[nodes], pair.after.points[nodes]])
    window = shaped(window_of(view, points, 0.25), (0.4, 1.0))
    return _twins(pair, choice, found, view, (window, window))


Flat = tuple[Facets, FloatArray, View]
"""Polygons, block outlines and view of a plane."""


def _twins(pair: Pair, choice: Choice, planes: Sequence[Flat], view: View, windows: tuple[Window, Window]) -> Page:
    """Two planes side by side in common colours."""
    scale = choice.scale(*(facets for facets, _, _ in planes))
    panels = [
        Panel(flat_scene(subject, choice, scale, facets, outlines, view), view, window, name)
        for subject, (facets, outlines, _), window, name in zip(
            (pair.old, pair.new), planes, windows, ("before", "after"), strict=True
        )
    ]
    return Page(tuple(panels), "", scale)


def worst_cells(
    pair: Pair,
    block: int,
    cell: Shape,
    choice: Choice | None = None,
) -> Page:
    """The surroundings of a cell (0-based ``cell`` of ``block``) before and after, on the same scale."""
    choice = choice or Choice()
    old, new = pair.old, pair.new
    flat = plane_of_grid(old, choice.metric), plane_of_grid(new, choice.metric)
    if flat[0] is not None and flat[1] is not None:
        planes, view = [flat[0], flat[1]], flat[0][2]
        sizes = _surroundings(pair, block, cell, view)
    else:
        axis, normal = _telling_plane(pair, block, cell)
        view = facing(normal)
        planes = [(_around(subject, block, axis, cell, normal, choice), np.empty((0, 2, 3)), view)
                  for subject in (old, new)]  # fmt: skip
        sizes = _surroundings(pair, block, cell, view)
    page = _twins(pair, choice, planes, view, sizes)
    panels = (
        dataclasses.replace(panel, title=name) for panel, name in zip(page.panels, ("before", "after"), strict=True)
    )
    return dataclasses.replace(page, panels=tuple(panels))


def _corners(grid: Grid, block: int, cell: Shape, more: int = 0) -> FloatArray:
    """Nodes (n, 3) of a cell and of ``more`` cells around it."""
    window = tuple(slice(max(at - more, 0), at + 2 + more) for at in cell)
    return grid.few(block, window).reshape(-1, 3)


def _surroundings(pair: Pair, block: int, cell: Shape, view: View) -> tuple[Window, Window]:
    """Windows of the same size around a cell before and after."""
    centers = [view.project(_corners(grid, block, cell).mean(axis=0))[:2] for grid in (pair.before, pair.after)]
    reach = 0.0
    for grid, center in zip((pair.before, pair.after), centers, strict=True):
        near = np.abs(view.project(_corners(grid, block, cell, _AROUND))[:, :2] - center).max(axis=1)
        # Where cells grow quickly, the window is limited so that the worst cell remains visible.
        close = np.abs(view.project(_corners(grid, block, cell, 1))[:, :2] - center).max()
        reach = max(reach, min(float(np.quantile(near, 0.7)), 8.0 * float(close)))
    one, two = (
        (float(x) - reach, float(x) + reach, float(y) - 0.8 * reach, float(y) + 0.8 * reach) for x, y in centers
    )
    return one, two


def _telling_plane(pair: Pair, block: int, cell: Shape) -> tuple[int, FloatArray]:
    """Index axis and normal of the plane in which a cell looks worst: smallest over largest corner area."""
    found = []
    for axis in range(3):
        window = tuple(slice(at, at + (1 if a == axis else 2)) for a, at in enumerate(cell))
        old, new = (grid.few(block, window).reshape(2, 2, 3) for grid in (pair.before, pair.after))
        normal = np.cross(old[1, 1] - old[0, 0], old[0, 1] - old[1, 0])
        length = float(np.linalg.norm(normal))
        if length == 0.0:
            continue
        corner = [np.cross(new[1 - a, b] - new[a, b], new[a, 1 - b] - new[a, b]) * (1 if a == b else -1)
                  for a in (0, 1) for b in (0, 1)]  # fmt: skip
        size = [np.linalg.norm(new[1 - a, b] - new[a, b]) * np.linalg.norm(new[a, 1 - b] - new[a, b])
                for a in (0, 1) for b in (0, 1)]  # fmt: skip
        sign = np.sign(np.cross(old[1, 0] - old[0, 0], old[0, 1] - old[0, 0]) @ normal)
        found.append((min(sign * (c @ normal) / length / max(s, 1e-300) for c, s in zip(corner, size, strict=True)),
                      axis, normal / length))  # fmt: skip
    _, axis, normal = min(found, key=lambda each: each[0])
    return axis, normal


def _around(subject: Subject, block: int, axis: int, cell: Shape, normal: FloatArray, choice: Choice) -> Facets:
    """The index plane of a block through a cell, and where its plane in space cuts the other blocks."""
    own = block_facets(subject, block, axis, cell[axis], choice.metric)
    center = _corners(subject.grid, block, cell).mean(axis=0)
    cut = cut_facets(subject, Plane(center, normal), choice.metric)
    # Drawn behind the index plane, which may deviate from the plane in space but stays in front everywhere.
    behind = dataclasses.replace(cut, corners=cut.corners - subject.size * normal * np.sign(_viewed(normal)))
    return joined([own, behind])


def _viewed(normal: FloatArray) -> float:
    """Whether a normal points towards a viewer who faces its plane."""
    return float(facing(normal).towards @ normal)


def quality_planes(pair: Pair) -> tuple[Page, Page]:
    """A plane through the grid around its walls, before and after, in the same frame and colours (for a slider)."""
    return apart(_planes_around(pair, Choice(), _wall_points(pair, body_walls(pair.old))))


def apart(page: Page) -> tuple[Page, Page]:
    """The two panels of a page as pages of the same size, axes, colour bar and legend, without their titles."""
    panels = [dataclasses.replace(panel, title="") for panel in page.panels]
    one, two = (dataclasses.replace(page, panels=(panel,), explained=page.invalid > 0) for panel in panels)
    return one, two


def plane_around(subject: Subject, points: FloatArray, choice: Choice) -> Page:
    """A plane through a grid around ``points`` (n, 3), coloured by quality; the whole plane if there are none."""
    choice = choice or Choice()
    facets, outlines, view = _plane_at(subject, choice)
    window = _window_around(view, facets, points)
    scale = choice.scale(facets)
    return Page((Panel(flat_scene(subject, choice, scale, facets, outlines, view), view, window),), "", scale)


def _planes_around(pair: Pair, choice: Choice, points: FloatArray) -> Page:
    planes = [_plane_at(subject, choice) for subject in (pair.old, pair.new)]
    view = planes[0][2]
    window = _window_around(view, planes[0][0], points)
    return _twins(pair, choice, planes, view, (window, window))


def _plane_at(subject: Subject, choice: Choice) -> Flat:
    """The plane of a flat grid, else a cut through the middle of the bodies."""
    flat = plane_of_grid(subject, choice.metric)
    if flat is not None:
        return flat
    plane = middle_plane(subject)
    return cut_facets(subject, plane, choice.metric), np.empty((0, 2, 3)), facing(plane.normal)


def _window_around(view: View, facets: Facets, points: FloatArray) -> Window:
    if not points.size:
        return shaped(window_of(view, facets.corners, 0.02), (0.3, 1.0))
    whole = window_of(view, facets.corners, 0.0)
    left, right, bottom, top = window_of(view, points, 0.6)
    left, right = max(left, whole[0]), min(right, whole[1])
    bottom, top = max(bottom, whole[2]), min(top, whole[3])
    return moved_into(shaped((left, right, bottom, top), (0.5, 0.9)), whole)


def _wall_points(pair: Pair, walls: Sequence[Surface]) -> FloatArray:
    """Nodes of walls before and after."""
    return np.concatenate([nodes_of(subject, walls) for subject in (pair.old, pair.new)])
