"""What is shown where nothing is specified: a grid, two grids before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from meshdeform_core.grid import FloatArray, Grid, IntArray, Shape
from meshdeform_core.grid.faces import Role
from meshdeform_core.grid.planes import Plane

from .colours import Choice
from .page import Page, Panel
from .scene import (
    Layer,
    Scene,
    cut_facets,
    cut_scene,
    face_layers,
    joined,
    layer_facets,
    layer_scene,
    onto_walls,
    wall_edges,
    whole_scene,
)
from .subject import Subject, quads_of_surfaces
from .view import Window, facing, iso

_SMALL = 0.3
"""Details smaller than this fraction of the picture along its larger side get a close-up."""
_TALL, _FLAT = 1.15, 0.05
_AROUND = 7
"""Number of cells that a close-up shows on either side of the worst one."""


def overview(subject: Subject, choice: Choice, title: str = "") -> Page:
    """A plane or extruded grid in plan view; else the walls and a cut, or the outside, in space.

    Small details have a close-up.
    """
    metric, bodies = choice.metric, subject.outside.bodies
    scene = whole_scene(subject, metric)
    if scene is not None:
        return Page.of(_with_close_up(subject, scene), choice, title)
    if not bodies:
        outside = layer_scene(subject, face_layers(subject, np.flatnonzero(subject.topology.external)), metric, iso())
        window = outside.view.window(outside.facets.corners).shaped(0.5, _TALL)
        return Page.of([Panel(outside, window, "outside")], choice, title)
    walls = layer_scene(subject, face_layers(subject, quads_of_surfaces(bodies)), metric, onto_walls(subject))
    backdrop = [each for each in subject.outside.of_role(Role.SYMMETRY, Role.WALL) if each not in bodies]
    if backdrop:
        walls = dataclasses.replace(walls, backdrop=subject.corners(backdrop))
    around = walls.view.window(walls.facets.corners, 0.08).shaped(0.7, 0.95)
    plane = subject.middle_plane()
    cut = cut_scene(subject, plane, metric)
    edges = wall_edges(subject, plane, bodies)
    points = edges if len(edges) else subject.corners(bodies)
    near = cut.view.window(points, 0.3).shaped(0.6, _TALL).moved_into(cut.view.window(cut.facets.corners, 0.0))
    axis = int(np.argmax(np.abs(plane.normal)))
    where = f"cut {'xyz'[axis]} = {plane.point[axis]:.4g}"
    return Page.of([Panel(walls, around, "walls"), Panel(cut, near, where)], choice, title)


def _with_close_up(subject: Subject, scene: Scene) -> list[Panel]:
    """A plane, whole; and close up, where the nodes of walls cluster, else where the cells are smallest, if that is a
    small part."""
    whole = scene.view.window(scene.facets.corners, 0.0)
    panel = Panel(scene, whole.grown(0.02 * whole.larger_side).shaped(_FLAT, _TALL))
    flat = scene.view.project(scene.facets.corners)[..., :2]
    walls = scene.view.project(subject.corners(subject.wall_surfaces).reshape(-1, 3))[:, :2]
    size = np.linalg.norm(flat[:, 2] - flat[:, 0], axis=1)
    points = walls if len(walls) else flat.mean(axis=1)[size <= np.quantile(size, 0.2)]
    # Bodies are shown completely, walls that cross the whole picture only where their nodes cluster.
    if not len(walls) or np.ptp(points, axis=0).max() > 0.7 * whole.larger_side:
        points = np.quantile(points, [0.2, 0.8], axis=0)
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    detail = Window(left, right, bottom, top)
    if not 0.0 < detail.larger_side <= _SMALL * whole.larger_side:
        return [panel]
    detail = detail.grown(0.35 * detail.larger_side).within(whole)
    near = detail.shaped(max(_FLAT, min(0.5, panel.aspect)), min(_TALL, max(panel.aspect, 0.5))).moved_into(whole)
    return [dataclasses.replace(panel, title="whole grid", frames=(near,)), Panel(scene, near, "close-up")]


def _twins(scenes: Sequence[Scene], windows: Sequence[Window], choice: Choice) -> Page:
    """The same part of two grids side by side in common colours, from the first one's direction."""
    view = scenes[0].view
    panels = [
        Panel(dataclasses.replace(scene, view=view), window, name)
        for scene, window, name in zip(scenes, windows, ("before", "after"), strict=True)
    ]
    return Page.of(panels, choice)


def moved_walls(old: Subject, new: Subject, quads: IntArray) -> Page | None:
    """Moving face quads where they have gone, coloured by displacement; ``None`` for flat grids."""
    if old.grid.dimension == 2 or old.end_plane is not None:
        return None
    walls = layer_scene(new, face_layers(new, quads), "displacement", onto_walls(old))
    window = walls.view.window(walls.facets.corners, 0.06).shaped(0.6, 1.0)
    return Page.of([Panel(walls, window)], Choice("displacement"))


def quality_planes(old: Subject, new: Subject) -> Page:
    """A plane through the grid around its walls, before and after, in the same frame and colours."""
    scenes = [_plane(subject, Choice()) for subject in (old, new)]
    window = _window_around(scenes[0], np.concatenate([subject.corners(old.outside.bodies) for subject in (old, new)]))
    return _twins(scenes, (window, window), Choice())


def plane_around(subject: Subject, points: FloatArray, choice: Choice) -> Page:
    """A plane through a grid around ``points`` (n, 3), coloured by quality; the whole plane if there are none."""
    scene = _plane(subject, choice)
    return Page.of([Panel(scene, _window_around(scene, points))], choice)


def _plane(subject: Subject, choice: Choice) -> Scene:
    """The plane of a flat grid, else a cut through the middle of the bodies."""
    return whole_scene(subject, choice.metric) or cut_scene(subject, subject.middle_plane(), choice.metric)


def _window_around(scene: Scene, points: FloatArray) -> Window:
    whole = scene.view.window(scene.facets.corners, 0.0)
    if not points.size:
        return whole.grown(0.02 * whole.larger_side).shaped(0.3, 1.0)
    return scene.view.window(points, 0.6).within(whole).shaped(0.5, 0.9).moved_into(whole)


def worst_cells(old: Subject, new: Subject, block: int, cell: Shape, choice: Choice | None = None) -> Page:
    """The surroundings of a cell (0-based ``cell`` of ``block``) before and after, on the same scale.

    In space it is the index plane of the block through the cell, and where its plane cuts the other blocks.
    """
    choice = choice or Choice()
    scenes = [whole_scene(subject, choice.metric) for subject in (old, new)]
    found = [scene for scene in scenes if scene is not None]
    if len(found) < 2:
        axis, normal = telling_plane(old.grid, new.grid, block, cell)
        found, view = [], facing(normal)
        for subject in (old, new):
            own = layer_facets(subject, [Layer(block, axis, cell[axis])], choice.metric)
            plane = Plane(_nodes_around(subject.grid, block, cell).mean(axis=0), normal)
            cut = cut_facets(subject, plane, choice.metric)
            # Drawn behind the index plane, which may deviate from the plane in space but stays in front everywhere.
            behind = dataclasses.replace(cut, corners=cut.corners - subject.size * view.towards)
            found.append(Scene(joined([own, behind]), view))
    # Windows of the same size around a cell before and after.
    view = found[0].view
    centers, reach = [], 0.0
    for grid in (old.grid, new.grid):
        center = view.project(_nodes_around(grid, block, cell).mean(axis=0))[:2]
        near, close = (
            np.abs(view.project(_nodes_around(grid, block, cell, more))[:, :2] - center).max(axis=1)
            for more in (_AROUND, 1)
        )
        # Where cells grow quickly, the window is limited so that the worst cell remains visible.
        reach = max(reach, min(float(np.quantile(near, 0.7)), 8.0 * float(close.max())))
        centers.append(center.tolist())
    return _twins(found, [Window(x - reach, x + reach, y - 0.8 * reach, y + 0.8 * reach) for x, y in centers], choice)


def _nodes_around(grid: Grid, block: int, cell: Shape, more: int = 0) -> FloatArray:
    """Nodes (n, 3) of a cell and of ``more`` cells around it."""
    window = tuple(slice(max(at - more, 0), at + 2 + more) for at in cell)
    return grid.few(block, window).reshape(-1, 3)


def telling_plane(before: Grid, after: Grid, block: int, cell: Shape) -> tuple[int, FloatArray]:
    """Index axis and normal of the plane in which a cell looks worst: smallest over largest corner area."""
    found = []
    for axis in range(3):
        window = tuple(slice(at, at + (1 if a == axis else 2)) for a, at in enumerate(cell))
        # The corners of a face in cyclic order.
        old, new = (grid.few(block, window).reshape(4, 3)[[0, 2, 3, 1]] for grid in (before, after))
        normal = np.cross(old[2] - old[0], old[3] - old[1])
        length = float(np.linalg.norm(normal))
        if length == 0.0:
            continue
        ahead, behind = np.roll(new, -1, axis=0) - new, np.roll(new, 1, axis=0) - new
        size = np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1)
        area = np.cross(ahead, behind) @ normal / length
        found.append((float((area / np.maximum(size, 1e-300)).min()), axis, normal / length))
    _, axis, normal = min(found, key=lambda each: each[0])
    return axis, normal
