"""The default picture of a grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.faces import Face
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.roles import Role
from meshdeform_core.grid.surfaces import Surface

from .colours import Scale, scale_of
from .facets import Facets, block_outlines, cut_facets, joined, plane_facets, plane_outlines, surface_facets
from .figure import Page, Panel
from .image import Scene
from .subject import Subject
from .view import View, Window, facing, iso, shaped, towards, window_of

_SMALL = 0.3
"""A detail smaller than this fraction of the picture, along its larger side, has a close-up."""
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
    flat = plane_of_grid(subject, choice)
    if flat is not None:
        return flat_page(subject, choice, *flat, title)
    walls = body_walls(subject)
    return _walls_and_cut(subject, choice, walls, title) if walls else _outside(subject, choice, title)


def body_walls(subject: Subject) -> tuple[Surface, ...]:
    """Walls of bodies in the grid, not the floors and sides of a channel or a box."""
    whole = np.ptp(subject.grid.points, axis=0)
    walls = subject.outside.of_role(Role.WALL)
    return tuple(wall for wall in walls if int((np.ptp(wall.box, axis=0) > 0.6 * whole).sum()) < 2)


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
        wanted = max(_FLAT, min(0.5, panels[0].aspect)), min(_TALL, max(panels[0].aspect, 0.5))
        near = moved_into(shaped(detail, wanted), window_of(view, facets.corners, 0.0))
        panels = [
            dataclasses.replace(panels[0], title="whole grid", frames=(near,)),
            Panel(scene, view, near, "close-up"),
        ]
    return Page(tuple(panels), title, scale)


def flat_scene(
    subject: Subject, choice: Choice, scale: Scale, facets: Facets, outlines: FloatArray, view: View
) -> Scene:
    """Polygons in a plane with the edges of blocks and walls."""
    edges = _wall_edges(subject, facets, view)
    return Scene(facets, scale.colours(facets), outlines, edges, lines=choice.lines)


def _wall_edges(subject: Subject, facets: Facets, view: View) -> FloatArray:
    """Edges (n, 2, 3) of walls in the plane of a flat picture."""
    walls = subject.outside.of_role(Role.WALL)
    if not walls:
        return np.empty((0, 2, 3))
    nodes = subject.topology.quads.corners[np.concatenate([wall.quads for wall in walls])]
    x = subject.grid.points[subject.topology.first[nodes]]
    edges = np.concatenate([x[:, [n, (n + 1) % x.shape[1]]] for n in range(x.shape[1])])
    level = float(view.project(facets.corners[0, 0])[2])
    inside = np.abs(view.project(edges)[..., 2] - level).max(axis=1) <= 1e-6 * subject.size
    return edges[inside]


def moved_into(window: Window, whole: Window) -> Window:
    """A window shifted into the whole, as far as it fits."""
    left, right, bottom, top = window
    rim = 0.03 * _extent(window)
    across = max(whole[0] - rim - left, 0.0) or min(whole[1] + rim - right, 0.0)
    along = max(whole[2] - rim - bottom, 0.0) or min(whole[3] + rim - top, 0.0)
    return left + across, right + across, bottom + along, top + along


def plane_of_grid(subject: Subject, choice: Choice) -> tuple[Facets, FloatArray, View] | None:
    """Polygons, block outlines and view of a plane that represents the whole grid."""
    grid = subject.grid
    if grid.dimension == 2:
        assert subject.thin is not None
        return plane_facets(subject, 2, None, choice.metric), plane_outlines(subject, 2, None), facing(subject.thin)
    sides = _end_plane(subject)
    if sides is None:
        return None
    quads, normal = sides
    facets = surface_facets(subject, quads, choice.metric)
    return facets, block_outlines(grid, subject.topology, quads), facing(normal)


def _end_plane(subject: Subject) -> tuple[IntArray, FloatArray] | None:
    """Face quads and normal of one of the two end planes of an extruded grid."""
    found = subject.outside
    ends = [face for face, role in zip(found.faces, found.roles, strict=True) if role is Role.END]
    thin = subject.thin
    if not ends and thin is not None:
        ends = [f for f in found.faces if f.outside and f.plane is not None and abs(f.plane.normal @ thin) > 1 - 1e-6]
    if not ends or ends[0].plane is None:
        ends = _declared_ends(subject)
    if not ends or ends[0].plane is None:
        return None
    normal = ends[0].plane.normal
    height = [float(face.plane.point @ normal) if face.plane is not None else np.inf for face in ends]
    low = min(height)
    chosen = [f for f, h in zip(ends, height, strict=True) if h - low <= 1e-6 * subject.size]
    return np.concatenate([face.quads for face in chosen]), normal


def _declared_ends(subject: Subject) -> list[Face]:
    """Faces in two parallel symmetry planes between which all walls stand upright."""
    found = subject.outside
    planes = [f for f, role in zip(found.faces, found.roles, strict=True) if role is Role.SYMMETRY and f.plane]
    normals: list[FloatArray] = []
    for face in planes:
        assert face.plane is not None
        normal = face.plane.normal
        # The faces of many blocks lie in the same few planes.
        if any(abs(tried @ normal) > 1 - 1e-12 for tried in normals):
            continue
        normals.append(normal)
        same = [f for f in planes if f.plane is not None and abs(f.plane.normal @ normal) > 1 - 1e-6]
        heights = [float(f.plane.point @ normal) for f in same if f.plane is not None]
        level = subject.grid.points @ normal
        reach = 1e-6 * subject.size
        both = min(heights) <= level.min() + reach and max(heights) >= level.max() - reach
        walls = [f for f, role in zip(found.faces, found.roles, strict=True) if role is Role.WALL]
        upright = all(f.box[1] @ np.abs(normal) - f.box[0] @ np.abs(normal) >= 0.99 * np.ptp(level) for f in walls)
        if both and upright and walls and np.ptp(heights) > reach:
            return same
    return []


def _detail(subject: Subject, facets: Facets, view: View) -> Window | None:
    """Where the nodes of walls crowd, else where the cells are smallest; ``None`` if that is most of the picture."""
    whole = window_of(view, facets.corners, 0.0)
    walls = subject.outside.of_role(Role.WALL)
    if walls:
        quads = np.concatenate([wall.quads for wall in walls])
        nodes = np.unique(subject.topology.quads.corners[quads])
        points = view.project(subject.grid.points[subject.topology.first[nodes]])[:, :2]
        # Bodies are shown whole; walls from border to border where their nodes crowd.
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
    """The part of a window that holds anything."""
    left, right, bottom, top = window
    return max(left, whole[0]), min(right, whole[1]), max(bottom, whole[2]), min(top, whole[3])


def _middle(points: FloatArray) -> FloatArray:
    """The middle of points (n, 2), without the tails along either axis."""
    low, high = np.quantile(points, [0.2, 0.8], axis=0)
    return np.stack([low, high])


def _box(points: FloatArray) -> Window:
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    return float(left), float(right), float(bottom), float(top)


def _extent(window: Window) -> float:
    return max(window[1] - window[0], window[3] - window[2])


def _walls_and_cut(subject: Subject, choice: Choice, walls: Sequence[Surface], title: str) -> Page:
    quads = np.concatenate([wall.quads for wall in walls])
    surface = surface_facets(subject, quads, choice.metric)
    view = onto_walls(subject)
    others = subject.outside.of_role(Role.SYMMETRY, Role.WALL)
    backdrop = [each.quads for each in others if each not in walls]
    plane = cut_plane(subject, walls)
    cut = cut_facets(subject, plane, choice.metric)
    scale = choice.scale(surface, cut)
    lit = Scene(surface, scale.colours(surface), block_outlines(subject.grid, subject.topology, quads), lit=True,
                lines=choice.lines)  # fmt: skip
    if backdrop:
        lit = before_backdrop(lit, surface_facets(subject, np.concatenate(backdrop)))
    seen = shaped(window_of(view, surface.corners, 0.08), (0.7, 0.95))
    box = facing(plane.normal)
    near = _cut_window(subject, plane, box, walls)
    axis = int(np.argmax(np.abs(plane.normal)))
    panels = (
        Panel(lit, view, seen, "walls"),
        Panel(Scene(cut, scale.colours(cut), lines=choice.lines), box, near,
              f"cut {'xyz'[axis]} = {plane.point[axis]:.4g}"),
    )  # fmt: skip
    return Page(panels, title, scale)


def before_backdrop(scene: Scene, facets: Facets) -> Scene:
    """A scene with pale polygons added for orientation."""
    pale = np.tile(_PALE, (len(facets), 1))
    return dataclasses.replace(
        scene,
        facets=joined([scene.facets, facets]),
        colours=np.concatenate([scene.colours, pale]),
        unlit=scene.unlit + len(facets),
    )


def onto_walls(subject: Subject) -> View:
    """From in front of all axes, with symmetry planes behind the walls."""
    direction = np.array([0.8, -1.0, 0.7])
    walls = body_walls(subject)
    for surface in subject.outside.of_role(Role.SYMMETRY, Role.END, Role.WALL):
        if surface in walls:
            continue
        outward = _outward(subject, surface)
        if direction @ outward > 0:
            direction = direction - 2 * (direction @ outward) * outward
    return towards(direction)


def _outward(subject: Subject, surface: Surface) -> FloatArray:
    """Mean unit normal out of the grid."""
    corners = subject.grid.points[subject.topology.first[subject.topology.quads.corners[surface.quads]]]
    total = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]).sum(axis=0)
    length = float(np.linalg.norm(total))
    return np.asarray(total / length) if length > 0 else np.zeros(3)


def _box_of(walls: Sequence[Surface]) -> FloatArray:
    boxes = np.array([wall.box for wall in walls])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def cut_plane(subject: Subject, walls: Sequence[Surface]) -> Plane:
    """Through the middle of the walls, parallel to a symmetry plane, else across their longest extent."""
    box = _box_of(walls)
    normal = np.zeros(3)
    mirrors = subject.outside.of_role(Role.SYMMETRY)
    if mirrors:
        normal[int(np.argmax(np.abs(_outward(subject, mirrors[0]))))] = 1.0
    else:
        normal[int(np.argmax(box[1] - box[0]))] = 1.0
    return Plane(box.mean(axis=0), normal)


def middle_plane(subject: Subject) -> Plane:
    """Through the middle of the bodies, else of the grid, across its shortest extent."""
    walls = body_walls(subject)
    if walls:
        return cut_plane(subject, walls)
    low, high = subject.grid.points.min(axis=0), subject.grid.points.max(axis=0)
    return Plane(0.5 * (low + high), np.eye(3)[int(np.argmin(high - low))])


def _cut_window(subject: Subject, plane: Plane, view: View, walls: Sequence[Surface]) -> Window:
    """Around the part of the walls near a plane."""
    quads = np.concatenate([wall.quads for wall in walls])
    corners = subject.grid.points[subject.topology.first[subject.topology.quads.corners[quads]]]
    level = (corners - plane.point) @ plane.normal
    crossing = (level.min(axis=1) <= 0) & (level.max(axis=1) >= 0)
    points = corners[crossing] if crossing.any() else corners
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
