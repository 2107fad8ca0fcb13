"""Scenes: what is drawn of a grid, seen from where; planes of a grid, cuts through it, its outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.grid.planes import Plane

from .facets import Facets, block_outlines, cut_facets, plane_facets, plane_outlines, surface_facets
from .subject import Subject
from .view import View, facing, spread, towards


def _no_edges() -> FloatArray:
    return np.empty((0, 2, 3))


@dataclass(frozen=True)
class Scene:
    """Polygons, seen from a direction, with lines over them.

    Attributes
    ----------
    outlines : (k, 2, 3) edges drawn stronger than those of the polygons, where they are not hidden
    walls : (l, 2, 3) edges drawn stronger still
    lit : shade the polygons by their angle to the viewer
    backdrop : further polygons, for orientation: pale, not shaded
    colour : RGB of all polygons; without it they have the colours of their values, or of their groups
    """

    facets: Facets
    view: View
    outlines: FloatArray = field(default_factory=_no_edges)
    walls: FloatArray = field(default_factory=_no_edges)
    lit: bool = False
    backdrop: Facets | None = None
    colour: tuple[float, float, float] | None = None

    @property
    def absent(self) -> bool:
        """Some polygons that have the colours of values have no value."""
        return self.colour is None and not np.isfinite(self.facets.values).all()


def whole_scene(subject: Subject, metric: str) -> Scene | None:
    """The plane that represents a whole grid: a plane grid itself, or an end of an extruded one; ``None`` without."""
    if subject.grid.dimension == 2:
        assert subject.thin is not None
        normal = subject.thin
        facets, outlines = plane_facets(subject, 2, None, metric), plane_outlines(subject, 2, None)
    elif subject.end_plane is not None:
        quads, normal = subject.end_plane
        facets = surface_facets(subject, quads, metric)
        outlines = block_outlines(subject.grid, subject.topology, quads)
    else:
        return None
    return Scene(facets, facing(normal), outlines, wall_edges(subject, Plane(facets.corners[0, 0], normal)))


def index_scene(
    subject: Subject, axis: int, index: int | None, metric: str, blocks: Sequence[int] | None = None
) -> Scene:
    """A plane of nodes, see :func:`plane_facets`."""
    facets = plane_facets(subject, axis, index, metric, blocks)
    view, outlines = spread(facets.corners), plane_outlines(subject, axis, index, blocks)
    if not view.flat:
        return Scene(facets, view, outlines, lit=True)
    return Scene(facets, view, outlines, wall_edges(subject, Plane(facets.corners[0, 0], view.towards)))


def cut_scene(subject: Subject, plane: Plane, metric: str) -> Scene:
    """A cut through all blocks of a grid in space."""
    return Scene(cut_facets(subject, plane, metric), facing(plane.normal), walls=wall_edges(subject, plane))


def surface_scene(subject: Subject, quads: IntArray, metric: str, view: View | None = None) -> Scene:
    """Face quads of a grid in space from a direction; without one flat ones in plan view, others towards the walls."""
    facets = surface_facets(subject, quads, metric)
    outlines = block_outlines(subject.grid, subject.topology, quads)
    plan = spread(facets.corners)
    if plan.flat and view is None:
        return Scene(facets, plan, outlines, wall_edges(subject, Plane(facets.corners[0, 0], plan.towards)))
    return Scene(facets, view or onto_walls(subject), outlines, lit=True)


def wall_edges(subject: Subject, plane: Plane, walls: Sequence[Surface] | None = None) -> FloatArray:
    """Lines (k, 2, 3) in which a plane cuts walls, by default all; of a plane grid the walls themselves."""
    corners = subject.corners(subject.wall_surfaces if walls is None else walls)
    if subject.grid.dimension == 2:
        return corners
    level, tiny = float(plane.point @ plane.normal), 1e-9 * subject.size
    # A plane along faces of cells is shifted slightly into the cells, as the cut of the cells is.
    level += -tiny if subject.reach(plane.normal)[1] - level <= 2 * tiny else tiny
    following = np.roll(corners, -1, axis=1)
    here, there = corners @ plane.normal - level, following @ plane.normal - level
    cut = (here > 0) != (there > 0)
    share = np.divide(here, here - there, out=np.zeros_like(here), where=cut)[..., None]
    points = corners + share * (following - corners)
    quads = np.flatnonzero(cut.any(axis=1))
    first, last = cut.argmax(axis=1), cut.shape[1] - 1 - cut[:, ::-1].argmax(axis=1)
    return np.stack([points[quads, end[quads]] for end in (first, last)], axis=1)


def onto_walls(subject: Subject) -> View:
    """An isometric view onto the walls, with symmetry planes behind them."""
    direction = np.array([0.8, -1.0, 0.7])
    bodies = subject.bodies
    middle = subject.box_of(bodies).mean(axis=0) if bodies else None
    for surface in subject.outside.of_role(Role.SYMMETRY, Role.END, Role.WALL):
        if surface in bodies:
            continue
        outward = subject.outward(surface)
        beyond = middle is not None and (middle - surface.box.mean(axis=0)) @ outward > 0
        if (direction @ outward > 0) != beyond:
            direction = direction - 2 * (direction @ outward) * outward
    return towards(direction)
