"""What is drawn of a grid, seen from where: polygons with values for their colours, and lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray, Side
from meshdeform_core.grid.faces import Role, Surface
from meshdeform_core.grid.planes import Plane

from .subject import Subject

no_edges = partial(np.empty, (0, 2, 3))


class Window(NamedTuple):
    """A rectangle in the picture's coordinates (length unit)."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.top - self.bottom

    @property
    def larger_side(self) -> float:
        """The larger of width and height."""
        return max(self.width, self.height)

    def grown(self, margin: float) -> Window:
        """With a margin on every side (length unit)."""
        return Window(self.left - margin, self.right + margin, self.bottom - margin, self.top + margin)

    def shaped(self, least: float, most: float) -> Window:
        """Enlarged until height over width is within limits."""
        wanted = min(max(self.height / self.width, least), most)
        width, height = max(self.width, self.height / wanted), max(self.height, wanted * self.width)
        x, y = 0.5 * (self.left + self.right), 0.5 * (self.bottom + self.top)
        return Window(x - width / 2, x + width / 2, y - height / 2, y + height / 2)

    def within(self, whole: Window) -> Window:
        """The part inside another one."""
        left, bottom = max(self.left, whole.left), max(self.bottom, whole.bottom)
        return Window(left, min(self.right, whole.right), bottom, min(self.top, whole.top))


@dataclass(frozen=True)
class View:
    """A parallel projection: unit vectors to the right, up and towards the viewer, and the names of the first two axes.

    Names are empty for axes of the picture that are not axes of the grid.
    """

    right: FloatArray
    up: FloatArray
    towards: FloatArray
    labels: tuple[str, str] = ("", "")

    @property
    def flat(self) -> bool:
        """Both axes of the picture are axes of the grid."""
        return all(self.labels)

    def project(self, points: FloatArray) -> FloatArray:
        """Coordinates (..., 3) in the picture: to the right, up and towards the viewer (length unit)."""
        return np.asarray(points @ np.stack([self.right, self.up, self.towards], axis=1))

    def window(self, points: FloatArray, margin: float = 0.04) -> Window:
        """The window that contains all points (..., 3), with a margin (fraction of the larger extent)."""
        flat = self.project(points.reshape(-1, 3))[:, :2]
        (left, bottom), (right, top) = flat.min(axis=0).tolist(), flat.max(axis=0).tolist()
        window = Window(left, right, bottom, top)
        return window.grown(margin * (window.larger_side or 1.0))


def along(axis: str) -> View:
    """The view against a coordinate axis, ``x``, ``y`` or ``z``, with the other two in their order."""
    unit = np.eye(3)
    right, up = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}[axis]
    towards = unit["xyz".index(axis)] * (-1.0 if axis == "y" else 1.0)
    return View(unit[right], unit[up], towards, ("xyz"[right], "xyz"[up]))


def towards(direction: FloatArray) -> View:
    """The view from ``direction``; z points upwards, or y if the view is along z."""
    back = direction / np.linalg.norm(direction)
    up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return View(right, np.cross(back, right), back)


def iso() -> View:
    """The isometric view from the positive octant."""
    return towards(np.array([0.8, -1.0, 0.7]))


def facing(normal: FloatArray) -> View:
    """The view onto a plane; along a coordinate axis if that is its normal."""
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1 - 1e-6:
        return along("xyz"[axis])
    return towards(normal * np.sign(normal[axis]))


@dataclass(frozen=True)
class Facets:
    """Polygons: corners (n, m, 3), values (n,), and whether each belongs to an invalid cell (n,).

    Polygons with fewer than m corners repeat the last one.
    """

    corners: FloatArray
    values: FloatArray
    bad: BoolArray

    def __len__(self) -> int:
        return len(self.corners)


def stacked(parts: Sequence[FloatArray]) -> FloatArray:
    """Corners (n, m, 3) of several sets of polygons as one; those with fewer repeat the last one."""
    most = max(part.shape[1] for part in parts)
    return np.concatenate([np.pad(p, ((0, 0), (0, most - p.shape[1]), (0, 0)), mode="edge") for p in parts])


def joined(parts: Sequence[Facets]) -> Facets:
    """Several sets of polygons as one."""
    values, bad = np.concatenate([part.values for part in parts]), np.concatenate([part.bad for part in parts])
    return Facets(stacked([part.corners for part in parts]), values, bad)


class Layer(NamedTuple):
    """A plane of nodes of a block, ``plane`` (0-based) along ``axis``; of its ``quads`` (na, nb) some, or all."""

    block: int
    axis: int
    plane: int
    quads: BoolArray | None = None

    def nodes(self, grid: Grid) -> FloatArray:
        """The nodes (na, nb, 3)."""
        shape = grid.shapes[self.block]
        window = [slice(self.plane, self.plane + 1) if a == self.axis else slice(0, n) for a, n in enumerate(shape)]
        return grid.few(self.block, window).squeeze(axis=self.axis)


def index_layers(grid: Grid, axis: int, index: int | None) -> list[Layer]:
    """The planes ``index`` (0-based node, ``None``: the middle) along ``axis`` of all blocks that extend to it.

    A 2-D grid is shown completely. Raises CaseError when no block extends to the index.
    """
    found = []
    for block, shape in enumerate(grid.shapes):
        along = shape.index(1) if grid.dimension == 2 else axis
        at = (shape[along] - 1) // 2 if index is None or grid.dimension == 2 else index
        if at < shape[along]:
            found.append(Layer(block, along, at))
    if not found:
        longest = max(shape[axis] for shape in grid.shapes)
        raise CaseError(f"no block has a node plane {'ijk'[axis]} = {(index or 0) + 1}; the largest is {longest}")
    return found


def face_layers(subject: Subject, quads: IntArray) -> list[Layer]:
    """The block faces that face quads of a 3-D grid belong to, with these quads."""
    topology, found = subject.topology, []
    for block_side, some in topology.quads.by_side(quads):
        block, side = block_side // 6, Side(block_side % 6)
        mask = np.zeros(tuple(topology.quads.counts[block, side]), dtype=bool)
        mask.ravel()[some - topology.quads.start[block, side]] = True
        found.append(Layer(block, side.axis, side.layer(subject.grid.shapes[block]), mask))
    return found


def layer_facets(subject: Subject, layers: Sequence[Layer], metric: str) -> Facets:
    """Quads of layers, each with the value of the cell behind it."""
    parts = []
    for layer in layers:
        x = layer.nodes(subject.grid)
        corners = np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3)
        whole = subject.whole(layer.block)
        behind = min(layer.plane, whole[layer.axis].stop - 1)
        i, j, k = (slice(behind, behind + 1) if a == layer.axis else all_ for a, all_ in enumerate(whole))
        cells = i, j, k
        with subject.ready(metric):
            values = subject.of_all(partial(subject.shown, metric, layer.block), layer.block, cells)
            bad = subject.of_all(partial(subject.bad, layer.block), layer.block, cells)
        some = slice(None) if layer.quads is None else layer.quads.ravel()
        parts.append(Facets(corners[some], values.ravel()[some], bad.ravel()[some]))
    return joined(parts)


def cut_facets(subject: Subject, plane: Plane, metric: str) -> Facets:
    """The cells of all blocks of a 3-D grid where a plane in space cuts them, as polygons.

    Raises CaseError when the plane misses the grid.
    """
    level = subject.level(plane)
    with subject.ready(metric):
        parts = [_cut_block(subject, block, plane.normal, level, metric) for block in range(subject.grid.n_blocks)]
    return joined([part for some in subject.grid.nodes.gather(parts) for part in some])


def _cut_block(subject: Subject, block: int, normal: FloatArray, level: float, metric: str) -> Facets:
    """The cells of this rank in which x . ``normal`` = ``level`` somewhere."""
    nothing, cells = (
        Facets(np.empty((0, 6, 3)), np.empty(0), np.empty(0, bool)),
        subject.own(block, subject.whole(block)),
    )
    if cells[0].start == cells[0].stop:
        return nothing
    x = subject.nodes(block, cells)
    value = x @ normal - level
    corner = [np.s_[a : a - 1 or None, b : b - 1 or None, c : c - 1 or None] for a, b, c in np.ndindex(2, 2, 2)]
    above = np.sum([value[each] > 0 for each in corner], axis=0)
    at = np.nonzero((above > 0) & (above < 8))
    if at[0].size == 0:
        return nothing
    values = np.stack([value[each][at] for each in corner], axis=1)
    corners = _polygons(np.stack([x[each][at] for each in corner], axis=1), values, facing(normal))
    return Facets(corners, subject.shown(metric, block, cells)[at], subject.bad(block, cells)[at])


# The twelve edges of a cell, between corners 4 a + 2 b + c.
_EDGES = np.array([(n, n + step) for step in (1, 2, 4) for n in range(8) if not n & step])


def _polygons(points: FloatArray, values: FloatArray, view: View) -> FloatArray:
    """Sections (n, 6, 3) of cells (n, 8, 3) with signed distances (n, 8) to the plane of a view, in cyclic order."""
    (one, two), (start, end) = (np.moveaxis(each[:, _EDGES], 2, 0) for each in (values, points))
    cut = (one > 0) != (two > 0)
    share = np.where(cut, one / np.where(cut, one - two, 1.0), 0.0)
    at = start + share[..., None] * (end - start)
    arms = at - ((at * cut[..., None]).sum(axis=1) / cut.sum(axis=1)[:, None])[:, None]
    order = np.argsort(np.where(cut, np.arctan2(arms @ view.up, arms @ view.right), np.inf), axis=1)
    count = np.minimum(cut.sum(axis=1), 6)
    last = np.minimum(np.arange(6)[None, :], count[:, None] - 1)
    return np.asarray(np.take_along_axis(at, np.take_along_axis(order, last, axis=1)[..., None], axis=1))


def _outline(x: FloatArray, mask: BoolArray | None) -> FloatArray:
    """Edges (n, 2, 3) between marked (``None``: all) and other quads of a layer of nodes."""
    padded = np.pad(np.ones((x.shape[0] - 1, x.shape[1] - 1), dtype=bool) if mask is None else mask, 1)
    across = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    along = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    ends = [(x[across], x[across[0], across[1] + 1]), (x[along], x[along[0] + 1, along[1]])]
    return np.concatenate([np.stack(each, axis=1) for each in ends])


@dataclass(frozen=True)
class Scene:
    """Polygons, seen from a direction, with lines over them.

    Attributes
    ----------
    outlines : (k, 2, 3) edges drawn stronger than those of the polygons, where they are not hidden
    walls : (l, 2, 3) edges drawn stronger still
    lit : shade the polygons by their angle to the viewer
    backdrop : corners (m, 4, 3) of further polygons, for orientation: pale, not shaded
    """

    facets: Facets
    view: View
    outlines: FloatArray = field(default_factory=no_edges)
    walls: FloatArray = field(default_factory=no_edges)
    lit: bool = False
    backdrop: FloatArray | None = None


def whole_scene(subject: Subject, metric: str) -> Scene | None:
    """The plane that represents a whole grid: a plane grid itself, or an end of an extruded one; ``None`` without."""
    if subject.grid.dimension == 2:
        assert subject.thin is not None
        return layer_scene(subject, index_layers(subject.grid, 2, None), metric, facing(subject.thin), lit=False)
    if subject.end_plane is None:
        return None
    quads, normal = subject.end_plane
    return layer_scene(subject, face_layers(subject, quads), metric, facing(normal), lit=False)


def cut_scene(subject: Subject, plane: Plane, metric: str) -> Scene:
    """A cut through all blocks of a grid in space."""
    return Scene(cut_facets(subject, plane, metric), facing(plane.normal), walls=wall_edges(subject, plane))


def layer_scene(
    subject: Subject, layers: Sequence[Layer], metric: str, view: View | None = None, lit: bool = True
) -> Scene:
    """Layers in space, or in plan view (not ``lit``) with the lines in which their plane cuts walls.

    Without a ``view`` those that are flat are seen in plan view, others towards the walls.
    """
    facets = layer_facets(subject, layers, metric)
    outlines = np.concatenate([_outline(layer.nodes(subject.grid), layer.quads) for layer in layers])
    if view is None:
        size = np.ptp(facets.corners, axis=(0, 1))
        lit = bool(size.min() > 1e-6 * size.max())
        view = onto_walls(subject) if lit else along("xyz"[int(np.argmin(size))])
    walls = no_edges() if lit else wall_edges(subject, Plane(facets.corners[0, 0], view.towards))
    return Scene(facets, view, outlines, walls, lit)


def wall_edges(subject: Subject, plane: Plane, walls: Sequence[Surface] | None = None) -> FloatArray:
    """Lines (k, 2, 3) in which a plane cuts walls, by default all; of a plane grid the walls themselves."""
    corners = subject.corners(subject.wall_surfaces if walls is None else walls)
    if subject.grid.dimension == 2:
        return corners
    level = subject.level(plane)
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
    bodies = subject.outside.bodies
    middle = subject.box_of(bodies).mean(axis=0) if bodies else None
    for surface in subject.outside.of_role(Role.SYMMETRY, Role.END, Role.WALL):
        if surface in bodies:
            continue
        outward = subject.outward(surface)
        beyond = middle is not None and (middle - surface.box.mean(axis=0)) @ outward > 0
        if (direction @ outward > 0) != beyond:
            direction = direction - 2 * (direction @ outward) * outward
    return towards(direction)
