"""The default picture of a grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.grid.planes import Plane

from .content.end_plane import plane_of_grid
from .content.facets import Facets, block_outlines, cut_facets, joined, surface_facets
from .content.subject import Subject
from .content.walls import all_walls, body_walls, corners_of, cut_plane, nodes_of, onto_walls, quads_of
from .drawing.colours import Scale, scale_of
from .drawing.image import Scene
from .drawing.page import Page, Panel
from .view import View, Window, facing, iso, shaped, window_of

_SMALL = 0.3
"""Details smaller than this fraction of the picture along its larger side get a close-up."""
_LOST, _NOSE_NODES = 1e-3, (4, 9)
"""If first cells are lower than this fraction of a close-up, a second close-up shows that many nodes of the wall."""
_NOSE = 0.08
"""Largest close-up of a leading edge, as a fraction of the picture around it."""
_SQUARE = (0.85, 1.15)
_TALL, _FLAT = 1.15, 0.05
_PALE = np.array([0.93, 0.94, 0.96])


@dataclasses.dataclass(frozen=True)
class Choice:
    """Metric and scale of the colours.

    ``limits`` of the colours, ``logarithmic`` scale, ``lines``: draw grid lines.
    """

    metric: str = "f_skew"
    limits: tuple[float, float] | None = None
    logarithmic: bool = False
    lines: bool = True

    def scale(self, *facets: Facets) -> Scale:
        """Colours for the values of all polygons together."""
        values = np.concatenate([each.values for each in facets])
        return scale_of(self.metric, values, self.limits, self.logarithmic)


def overview(subject: Subject, choice: Choice, title: str = "") -> Page:
    """A plane or extruded grid in plan view; else the walls and a cut, or the outside, in space.

    Small details have a close-up.
    """
    flat = plane_of_grid(subject, choice.metric)
    if flat is not None:
        return flat_page(subject, choice, *flat, title)
    walls = body_walls(subject)
    return _walls_and_cut(subject, choice, walls, title) if walls else _outside(subject, choice, title)


def flat_page(
    subject: Subject, choice: Choice, facets: Facets, outlines: FloatArray, view: View, title: str = ""
) -> Page:
    """Polygons in a plane, whole, and close up where the walls are if they are small."""
    scale = choice.scale(facets)
    scene = flat_scene(subject, choice, scale, facets, outlines, view)
    whole = shaped(window_of(view, facets.corners, 0.02), (_FLAT, _TALL))
    panels = [Panel(scene, view, whole)]
    detail = _detail(subject, facets, view)
    if detail is not None:
        nose = _nose(subject, scene.walls.reshape(-1, 3), view, detail)
        wanted = max(_FLAT, min(0.5, panels[0].aspect)), min(_TALL, max(panels[0].aspect, 0.5))
        near = moved_into(shaped(detail, wanted if nose is None else _SQUARE), window_of(view, facets.corners, 0.0))
        panels = [
            dataclasses.replace(panels[0], title="whole grid", frames=(near,)),
            *_close(Panel(scene, view, near, "close-up"), nose),
        ]
    return Page(tuple(panels), title, scale)


def _close(panel: Panel, nose: Window | None) -> list[Panel]:
    """A panel, and a close-up of a leading edge in it."""
    if nose is None:
        return [panel]
    return [
        dataclasses.replace(panel, frames=(nose,)),
        dataclasses.replace(panel, window=nose, title="leading edge"),
    ]


def _nose(subject: Subject, points: FloatArray, view: View, window: Window) -> Window | None:
    """A window at the leading (left) edge of walls with ``points`` (n, 3) whose first cells a window cannot show."""
    walls = body_walls(subject)
    height = min((wall.median_height for wall in walls), default=np.inf)
    flat = np.unique(view.project(points)[:, :2], axis=0)
    if height > _LOST * _extent(window) or len(flat) <= _NOSE_NODES[1]:
        return None
    distance = np.sort(np.linalg.norm(flat - flat[0], axis=1))
    reach = float(np.clip(200 * height, *distance[list(_NOSE_NODES)]))
    if reach == 0.0 or reach > _NOSE * _extent(window):
        return None
    x, y = flat[0].tolist()
    return shaped((x - reach, x + reach, y - reach, y + reach), _SQUARE)


def flat_scene(
    subject: Subject, choice: Choice, scale: Scale, facets: Facets, outlines: FloatArray, view: View
) -> Scene:
    """Polygons in a plane with the edges of blocks and walls."""
    edges = _wall_edges(subject, facets, view)
    return Scene(facets, scale.colours(facets), outlines, edges, lines=choice.lines)


def _wall_edges(subject: Subject, facets: Facets, view: View) -> FloatArray:
    """Edges (n, 2, 3) of walls in the plane of a flat picture."""
    x = corners_of(subject, all_walls(subject))
    if not len(x):
        return np.empty((0, 2, 3))
    edges = np.concatenate([x[:, [n, (n + 1) % x.shape[1]]] for n in range(x.shape[1])])
    level = float(view.project(facets.corners[0, 0])[2])
    inside = np.abs(view.project(edges)[..., 2] - level).max(axis=1) <= 1e-6 * subject.size
    return edges[inside]


def moved_into(window: Window, whole: Window) -> Window:
    """A window shifted to lie within the whole picture, as far as it fits."""
    left, right, bottom, top = window
    rim = 0.03 * _extent(window)
    across = max(whole[0] - rim - left, 0.0) or min(whole[1] + rim - right, 0.0)
    along = max(whole[2] - rim - bottom, 0.0) or min(whole[3] + rim - top, 0.0)
    return left + across, right + across, bottom + along, top + along


def _detail(subject: Subject, facets: Facets, view: View) -> Window | None:
    """A window where the nodes of walls cluster, else where the cells are smallest; ``None`` if it is nearly all."""
    whole = window_of(view, facets.corners, 0.0)
    walls = all_walls(subject)
    if walls:
        points = view.project(nodes_of(subject, walls))[:, :2]
        # Bodies are shown completely, walls that cross the whole picture only where their nodes cluster.
        if _extent(_box(points)) > 0.7 * _extent(whole):
            points = _middle(points)
    else:
        flat = view.project(facets.corners)[..., :2]
        size = np.linalg.norm(flat[:, 2] - flat[:, 0], axis=1)
        points = _middle(flat.mean(axis=1)[size <= np.quantile(size, 0.2)])
    near = _box(points)
    if _extent(near) > _SMALL * _extent(whole) or _extent(near) == 0.0:
        return None
    margin = 0.35 * _extent(near)
    left, right, bottom, top = near[0] - margin, near[1] + margin, near[2] - margin, near[3] + margin
    return _within((left, right, bottom, top), whole)


def _within(window: Window, whole: Window) -> Window:
    """The part of a window that is not empty."""
    left, right, bottom, top = window
    return max(left, whole[0]), min(right, whole[1]), max(bottom, whole[2]), min(top, whole[3])


def _middle(points: FloatArray) -> FloatArray:
    """The range of points (n, 2) without the tails along either axis."""
    low, high = np.quantile(points, [0.2, 0.8], axis=0)
    return np.stack([low, high])


def _box(points: FloatArray) -> Window:
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    return float(left), float(right), float(bottom), float(top)


def _extent(window: Window) -> float:
    return max(window[1] - window[0], window[3] - window[2])


def _walls_and_cut(subject: Subject, choice: Choice, walls: Sequence[Surface], title: str) -> Page:
    quads = quads_of(walls)
    surface = surface_facets(subject, quads, choice.metric)
    view = onto_walls(subject)
    others = subject.outside.of_role(Role.SYMMETRY, Role.WALL)
    backdrop = [each for each in others if each not in walls]
    plane = cut_plane(subject, walls)
    cut = cut_facets(subject, plane, choice.metric)
    scale = choice.scale(surface, cut)
    lit = Scene(surface, scale.colours(surface), block_outlines(subject.grid, subject.topology, quads), lit=True,
                lines=choice.lines)  # fmt: skip
    if backdrop:
        lit = before_backdrop(lit, surface_facets(subject, quads_of(backdrop)))
    seen = shaped(window_of(view, surface.corners, 0.08), (0.7, 0.95))
    box = facing(plane.normal)
    edges = _section(corners_of(subject, walls), plane)
    points = edges.reshape(-1, 3) if len(edges) else nodes_of(subject, walls)
    near = _cut_window(subject, points, box)
    nose = _nose(subject, points, box, near)
    near = near if nose is None else shaped(near, _SQUARE)
    axis = int(np.argmax(np.abs(plane.normal)))
    name = f"cut {'xyz'[axis]} = {plane.point[axis]:.4g}"
    close = _close(Panel(Scene(cut, scale.colours(cut), walls=edges, lines=choice.lines), box, near, name), nose)
    return Page((Panel(lit, view, seen, "walls"), *close), title, scale)


def before_backdrop(scene: Scene, facets: Facets) -> Scene:
    """A scene with pale polygons added for orientation."""
    pale = np.tile(_PALE, (len(facets), 1))
    return dataclasses.replace(
        scene,
        facets=joined([scene.facets, facets]),
        colours=np.concatenate([scene.colours, pale]),
        unlit=scene.unlit + len(facets),
    )


def _section(corners: FloatArray, plane: Plane) -> FloatArray:
    """Sections (k, 2, 3) of face quads (n, m, 3) with a plane."""
    following = np.roll(corners, -1, axis=1)
    here, there = ((x - plane.point) @ plane.normal for x in (corners, following))
    cut = (here > 0) != (there > 0)
    share = np.divide(here, here - there, out=np.zeros_like(here), where=cut)[..., None]
    points = corners + share * (following - corners)
    quads = np.flatnonzero(cut.any(axis=1))
    first, last = cut.argmax(axis=1), cut.shape[1] - 1 - cut[:, ::-1].argmax(axis=1)
    return np.stack([points[quads, end[quads]] for end in (first, last)], axis=1)


def _cut_window(subject: Subject, points: FloatArray, view: View) -> Window:
    """A window around the part of the walls near a plane."""
    whole = window_of(view, subject.grid.points, 0.0)
    return moved_into(shaped(window_of(view, points, 0.3), (0.6, _TALL)), whole)


def _outside(subject: Subject, choice: Choice, title: str) -> Page:
    quads = np.flatnonzero(subject.topology.external)
    facets = surface_facets(subject, quads, choice.metric)
    scale = choice.scale(facets)
    outlines = block_outlines(subject.grid, subject.topology, quads)
    scene = Scene(facets, scale.colours(facets), outlines, lit=True, lines=choice.lines)
    view = iso()
    return Page((Panel(scene, view, shaped(window_of(view, facets.corners), (0.5, _TALL)), "outside"),), title, scale)
