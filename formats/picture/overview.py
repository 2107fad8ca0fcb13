"""The default picture of a grid, and its boundaries by name."""

from __future__ import annotations

import dataclasses

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.numerics.geometry.vectors import doubled_areas

from .colours import Choice, colour_of
from .facets import Facets, block_outlines, joined, surface_facets
from .page import Page, Panel
from .scene import Scene, cut_scene, onto_walls, surface_scene, wall_edges, whole_scene
from .subject import Subject, quads_of
from .view import View, Window, iso

_SMALL = 0.3
"""Details smaller than this fraction of the picture along its larger side get a close-up."""
_LOST, _NOSE_NODES = 1e-3, (4, 9)
"""If first cells are lower than this fraction of a close-up, a second close-up shows that many nodes of the wall."""
_NOSE = 0.08
"""Largest close-up of first cells, as a fraction of the picture around it."""
_SQUARE = (0.85, 1.15)
_TALL, _FLAT = 1.15, 0.05
_MOST_NAMES = 14
_PALE = (0.95, 0.95, 0.95)


def overview(subject: Subject, choice: Choice, title: str = "") -> Page:
    """A plane or extruded grid in plan view; else the walls and a cut, or the outside, in space.

    Small details have a close-up.
    """
    scene = whole_scene(subject, choice.metric)
    if scene is not None:
        return Page.of(_with_close_ups(subject, scene), choice, title)
    if subject.bodies:
        return Page.of(_walls_and_cut(subject, choice.metric), choice, title)
    outside = surface_scene(subject, np.flatnonzero(subject.topology.external), choice.metric, iso())
    window = outside.view.window(outside.facets.corners).shaped(0.5, _TALL)
    return Page.of([Panel(outside, window, "outside")], choice, title)


def _with_close_ups(subject: Subject, scene: Scene) -> list[Panel]:
    """A plane, whole, and close up where the walls are if they are small."""
    whole = scene.view.window(scene.facets.corners, 0.0)
    panel = Panel(scene, whole.grown(0.02 * whole.extent).shaped(_FLAT, _TALL))
    detail = _detail(subject, scene, whole)
    if detail is None:
        return [panel]
    nose = _first_cells(subject, scene.view, scene.walls, detail)
    wanted = max(_FLAT, min(0.5, panel.aspect)), min(_TALL, max(panel.aspect, 0.5))
    near = detail.shaped(*(wanted if nose is None else _SQUARE)).moved_into(whole)
    return [
        dataclasses.replace(panel, title="whole grid", frames=(near,)),
        *_framed(Panel(scene, near, "close-up"), nose),
    ]


def _framed(panel: Panel, nose: Window | None) -> list[Panel]:
    """A panel, and a close-up of first cells in it."""
    if nose is None:
        return [panel]
    return [dataclasses.replace(panel, frames=(nose,)), dataclasses.replace(panel, window=nose, title="first cells")]


def _detail(subject: Subject, scene: Scene, whole: Window) -> Window | None:
    """A window where the nodes of walls cluster, else where the cells are smallest; ``None`` if it is nearly all."""
    flat = scene.view.project(scene.facets.corners)[..., :2]
    walls = scene.view.project(subject.corners(subject.wall_surfaces).reshape(-1, 3))[:, :2]
    size = np.linalg.norm(flat[:, 2] - flat[:, 0], axis=1)
    points = walls if len(walls) else flat.mean(axis=1)[size <= np.quantile(size, 0.2)]
    # Bodies are shown completely, walls that cross the whole picture only where their nodes cluster.
    if not len(walls) or np.ptp(points, axis=0).max() > 0.7 * whole.extent:
        points = np.quantile(points, [0.2, 0.8], axis=0)
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    near = Window(left, right, bottom, top)
    return None if not 0.0 < near.extent <= _SMALL * whole.extent else near.grown(0.35 * near.extent).within(whole)


def _first_cells(subject: Subject, view: View, edges: FloatArray, window: Window) -> Window | None:
    """A window at the left end of the ``edges`` of walls, if their first cells are too low to be seen in a window."""
    height = min((wall.median_height for wall in subject.bodies), default=np.inf)
    flat = np.unique(view.project(edges.reshape(-1, 3))[:, :2], axis=0)
    if height > _LOST * window.extent or len(flat) <= _NOSE_NODES[1]:
        return None
    distance = np.sort(np.linalg.norm(flat - flat[0], axis=1))
    reach = float(np.clip(200 * height, *distance[list(_NOSE_NODES)]))
    if reach == 0.0 or reach > _NOSE * window.extent:
        return None
    x, y = flat[0].tolist()
    return Window(x, x, y, y).grown(reach)


def _walls_and_cut(subject: Subject, metric: str) -> list[Panel]:
    bodies = subject.bodies
    walls = surface_scene(subject, quads_of(bodies), metric, onto_walls(subject))
    backdrop = [each for each in subject.outside.of_role(Role.SYMMETRY, Role.WALL) if each not in bodies]
    if backdrop:
        walls = dataclasses.replace(walls, backdrop=surface_facets(subject, quads_of(backdrop)))
    plane = subject.middle_plane()
    cut = cut_scene(subject, plane, metric)
    edges = wall_edges(subject, plane, bodies)
    points = edges if len(edges) else subject.corners(bodies)
    near = cut.view.window(points, 0.3).shaped(0.6, _TALL).moved_into(cut.view.window(cut.facets.corners, 0.0))
    nose = _first_cells(subject, cut.view, edges, near)
    axis = int(np.argmax(np.abs(plane.normal)))
    title = f"cut {'xyz'[axis]} = {plane.point[axis]:.4g}"
    return [
        Panel(walls, walls.view.window(walls.facets.corners, 0.08).shaped(0.7, 0.95), "walls"),
        *_framed(Panel(cut, near if nose is None else near.shaped(*_SQUARE), title), nose),
    ]


def boundaries(subject: Subject, title: str = "") -> Page:
    """All outside faces coloured by family, patch, or role where they have no name.

    In 3-D those that would hide the rest (far field and planes that face the viewer) are omitted; small walls have a
    close-up. In a plane grid the edges are coloured.
    """
    groups = _groups(subject)
    legend = tuple((name, colour_of(number)) for number, name in enumerate(groups))[:_MOST_NAMES]
    if subject.grid.dimension == 2:
        strokes = tuple((subject.corners(group), colour_of(number)) for number, group in enumerate(groups.values()))
        panels = [
            dataclasses.replace(panel, scene=dataclasses.replace(panel.scene, colour=_PALE), strokes=strokes)
            for panel in overview(subject, Choice()).panels
        ]
        return Page(tuple(panels), title, None, legend)
    view = onto_walls(subject)
    scene = _outside(subject, groups, view)
    whole = Panel(scene, view.window(scene.facets.corners).shaped(0.5, 1.1), "outside")
    panels = [whole]
    if subject.bodies:
        near = view.window(subject.corners(subject.bodies), 0.1).shaped(0.7, 1.0)
        if near.width < 0.5 * whole.window.width:
            panels.append(dataclasses.replace(whole, window=near, title="walls"))
    return Page(tuple(panels), title, None, legend)


def _groups(subject: Subject) -> dict[str, list[Surface]]:
    """Surfaces by the name that the legend shows, walls first."""
    groups: dict[str, list[Surface]] = {}
    for surface in sorted(subject.outside.surfaces, key=lambda s: list(Role).index(s.role)):
        role = surface.role.value + ("" if surface.declared or surface.role is Role.UNKNOWN else "?")
        name = f"{surface.name} ({role})" if surface.named and surface.name != role else role
        groups.setdefault(name, []).append(surface)
    return groups


def _outside(subject: Subject, groups: dict[str, list[Surface]], view: View) -> Scene:
    """The surfaces in groups but for faces, other than walls, whose outer side faces the viewer."""
    parts, quads = [], []
    for number, surfaces in enumerate(groups.values()):
        for surface in surfaces:
            corners = subject.corners([surface])
            keep = np.full(len(corners), surface.role is Role.WALL) | (doubled_areas(corners) @ view.towards < 0)
            parts.append(Facets.plain(corners[keep], number))
            quads.append(surface.quads[keep])
    outlines: FloatArray = block_outlines(subject.grid, subject.topology, np.concatenate(quads))
    return Scene(joined(parts), view, outlines, lit=True)
