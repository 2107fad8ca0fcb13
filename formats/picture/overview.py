"""What is shown where nothing is specified, of a grid and of two, before and after; and as options ask."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, Grid, IntArray, Shape
from meshdeform_core.grid.faces import Role
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.numerics.arrays import extent

from .page import Page, Panel, Scale
from .scene import (
    Layer,
    Scene,
    View,
    Window,
    along,
    cut_facets,
    cut_scene,
    face_layers,
    facing,
    index_layers,
    iso,
    joined,
    layer_facets,
    layer_scene,
    onto_walls,
    towards,
    wall_edges,
    whole_scene,
)
from .subject import Subject, quads_of_surfaces, worst_cell

_SMALL = 0.3
"""Details smaller than this fraction of the picture along its larger side get a close-up."""
_TALL, _FLAT = 1.15, 0.05
_PLANE = r"([ijk])=(mid|[1-9]\d*)|([xyz])=([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_AROUND = 7
"""Number of cells that a close-up shows on either side of the worst one."""


def overview(subject: Subject, scale: Scale, title: str = "") -> Page:
    """A plane or extruded grid in plan view; else the walls and a cut, or the outside, in space.

    Small details have a close-up.
    """
    metric, bodies = scale.metric, subject.outside.bodies
    scene = whole_scene(subject, metric)
    if scene is not None:
        return Page.of(_with_close_up(subject, scene), scale, title)
    if not bodies:
        outside = layer_scene(subject, face_layers(subject, np.flatnonzero(subject.topology.external)), metric, iso())
        window = outside.view.window(outside.facets.corners).shaped(0.5, _TALL)
        return Page.of([Panel(outside, window, "outside")], scale, title)
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
    return Page.of([Panel(walls, around, "walls"), Panel(cut, near, where)], scale, title)


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


def _twins(scenes: Sequence[Scene], windows: Sequence[Window], scale: Scale) -> Page:
    """The same part of two grids side by side in common colours, from the first one's direction."""
    view = scenes[0].view
    panels = [
        Panel(dataclasses.replace(scene, view=view), window, name)
        for scene, window, name in zip(scenes, windows, ("before", "after"), strict=True)
    ]
    return Page.of(panels, scale)


def moved_walls(old: Subject, new: Subject, quads: IntArray) -> Page | None:
    """Moving face quads where they have gone, coloured by displacement; ``None`` for flat grids."""
    if old.grid.dimension == 2 or old.end_plane is not None:
        return None
    walls = layer_scene(new, face_layers(new, quads), "displacement", onto_walls(old))
    window = walls.view.window(walls.facets.corners, 0.06).shaped(0.6, 1.0)
    return Page.of([Panel(walls, window)], Scale("displacement"))


def quality_planes(old: Subject, new: Subject) -> Page:
    """The plane of a flat grid, else a cut through the middle of the bodies, around its walls, before and after, in the
    same frame and colours."""
    scale = Scale()
    before, after = (
        whole_scene(each, scale.metric) or cut_scene(each, each.middle_plane(), scale.metric) for each in (old, new)
    )
    whole = before.view.window(before.facets.corners, 0.0)
    points = np.concatenate([subject.corners(old.outside.bodies) for subject in (old, new)])
    if points.size:
        window = before.view.window(points, 0.6).within(whole).shaped(0.5, 0.9).moved_into(whole)
    else:
        window = whole.grown(0.02 * whole.larger_side).shaped(0.3, 1.0)
    return _twins([before, after], (window, window), scale)


def worst_cells(old: Subject, new: Subject, block: int, cell: Shape, scale: Scale | None = None) -> Page:
    """The surroundings of a cell (0-based ``cell`` of ``block``) before and after, on the same scale.

    In space it is the index plane of the block through the cell, and where its plane cuts the other blocks.
    """
    scale = scale or Scale()
    scenes = [whole_scene(subject, scale.metric) for subject in (old, new)]
    found = [scene for scene in scenes if scene is not None]
    if len(found) < 2:
        axis, normal = telling_plane(old.grid, new.grid, block, cell)
        found, view = [], facing(normal)
        for subject in (old, new):
            own = layer_facets(subject, [Layer(block, axis, cell[axis])], scale.metric)
            plane = Plane(_nodes_around(subject.grid, block, cell).mean(axis=0), normal)
            cut = cut_facets(subject, plane, scale.metric)
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
    return _twins(found, [Window(x - reach, x + reach, y - 0.8 * reach, y + 0.8 * reach) for x, y in centers], scale)


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


@dataclasses.dataclass(frozen=True)
class PlotOptions:
    """Options as ``meshdeform plot --help`` explains them; ``zoom`` and ``limits`` may be numbers instead of text.

    ``lead`` is what stands before the names in messages: two dashes on the command line.

    Raises CaseError when an option is not understood, or options exclude each other.
    """

    metric: str = "f_skew"
    plane: str | None = None
    select: tuple[str, ...] = ()
    view: str = "auto"
    zoom: str | Sequence[float] | None = None
    limits: str | Sequence[float] | None = None
    log: bool = False
    lead: str = ""

    def __post_init__(self) -> None:
        if self.plane and self.select:
            raise CaseError(f"{self.lead}plane and {self.lead}select exclude each other; give one of them")
        _ = self.scale, self.layer, self.direction, self.window

    @property
    def plain(self) -> bool:
        """Whether only the colouring is specified."""
        return not (self.plane or self.select or self.zoom) and self.view == "auto"

    @cached_property
    def scale(self) -> Scale:
        """What colours the cells."""
        if self.limits is None:
            return Scale(self.metric, None, self.log)
        # The command line has another name for it than Python, where `range` is a built-in function.
        name = f"{self.lead}range" if self.lead else "limits"
        low, high = _numbers(name, self.limits, "low,high", 2)
        if not low < high:
            raise CaseError(f"{name} {self.limits!r}: expected low < high")
        return Scale(self.metric, (low, high), self.log)

    @property
    def layer(self) -> tuple[str, float | None] | None:
        """Axis and place of the plane: ``k=3`` is ("k", 3), ``k=mid`` ("k", None), ``z=0.25`` ("z", 0.25)."""
        if self.plane is None:
            return None
        match = re.fullmatch(_PLANE, self.plane)
        if not match:
            raise CaseError(
                f"{self.lead}plane {self.plane!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like "
                f"z=0.25"
            )
        index, node, axis, at = match.groups()
        return index or axis, None if node == "mid" else float(node or at)

    @property
    def close(self) -> str:
        """``worst``, ``walls`` or nothing."""
        return self.zoom if isinstance(self.zoom, str) and self.zoom in ("worst", "walls") else ""

    @cached_property
    def window(self) -> Window | None:
        """A part of the picture by numbers."""
        if self.zoom is None or self.close:
            return None
        window = Window(*_numbers(f"{self.lead}zoom", self.zoom, "worst, walls or left,right,bottom,top", 4))
        if not (window.left < window.right and window.bottom < window.top):
            raise CaseError(
                f"{self.lead}zoom {self.zoom!r}: expected left,right,bottom,top with left < right, bottom < top"
            )
        return window

    @cached_property
    def direction(self) -> View | None:
        """The view by name or direction; ``None`` for ``auto``."""
        if self.view in ("auto", "iso"):
            return iso() if self.view == "iso" else None
        if self.view in ("x", "y", "z"):
            return along(self.view)
        expected = "auto, x, y, z, iso or a direction like 1,-1,0.5"
        direction = np.array(_numbers(f"{self.lead}view", self.view, expected, 3))
        if not direction.any():
            raise CaseError(f"{self.lead}view {self.view!r}: a direction has a length")
        return towards(direction)


def _numbers(name: str, given: str | Sequence[float], expected: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in (given.split(",") if isinstance(given, str) else given))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise CaseError(f"{name} {given!r}: expected {expected}")
    return numbers


def picture(subject: Subject, options: PlotOptions, title: str = "") -> Page:
    """The page that options describe.

    Raises CaseError when a plane does not meet the grid, or a name matches nothing.
    """
    scale = options.scale
    if options.plain:
        return overview(subject, scale, title)
    if options.close == "worst":
        block, cell = worst_cell(subject, scale.metric)
        # The undeformed grid compared with itself, for measures that compare.
        old = Subject(subject.reference, subject.topology, subject.reference) if subject.reference else subject
        page = worst_cells(old, subject, block, cell, scale)
        before, after = page.panels
        after = dataclasses.replace(after, title=f"worst cell: {subject.grid.label(block, cell)}")
        panels = (after,) if subject.reference is None else (before, after)
        return dataclasses.replace(page, panels=panels, title=title)
    scene = _scene(subject, options)
    whole = scene.view.window(scene.facets.corners, 0.0)
    if options.window:
        window = options.window
        if max(window.left, whole.left) >= min(window.right, whole.right) or (
            max(window.bottom, whole.bottom) >= min(window.top, whole.top)
        ):
            raise CaseError(
                f"{options.lead}zoom {options.zoom!r} shows nothing of the grid, which extends from {whole.left:g} to "
                f"{whole.right:g} and from {whole.bottom:g} to {whole.top:g} in the picture"
            )
    elif options.close == "walls":
        if not subject.wall_surfaces:
            raise CaseError(f"{options.lead}zoom walls: no wall is known; see `meshdeform info`")
        window = scene.view.window(subject.corners(subject.wall_surfaces), 0.3).shaped(0.4, 1.2)
    else:
        window = scene.view.window(scene.facets.corners, 0.03).shaped(0.05, 1.4)
    return Page.of([Panel(scene, window)], scale, title)


def _scene(subject: Subject, options: PlotOptions) -> Scene:
    """The part of a grid that options name, in the direction that they ask for."""
    metric, (axis, at) = options.scale.metric, options.layer or ("", None)
    if options.select:
        if subject.grid.dimension == 2:
            raise CaseError("a 2-D grid has no surfaces to select; leave --select out to draw the whole grid")
        quads = select_quads(subject.reference or subject.grid, subject.topology, options.select, "plot")
        scene = layer_scene(subject, face_layers(subject, quads), metric)
    elif axis in ("i", "j", "k"):
        layers = index_layers(subject.grid, "ijk".index(axis), None if at is None else int(at) - 1)
        scene = layer_scene(subject, layers, metric)
    elif at is not None:
        if subject.grid.dimension == 2:
            raise CaseError(f"a 2-D grid cannot be cut; leave {options.lead}plane out to draw the whole grid")
        normal = np.eye(3)["xyz".index(axis)]
        low, high = (float(end @ normal) for end in extent(subject.grid.points))
        tiny = 1e-9 * subject.size
        if not low - tiny <= at <= high + tiny:
            raise CaseError(f"no part of the grid lies at {axis} = {at:g}; it spans {axis} = {low:.6g} to {high:.6g}")
        scene = cut_scene(subject, Plane(at * normal, normal), metric)
    else:
        walls = subject.wall_surfaces
        quads = quads_of_surfaces(walls) if walls else np.flatnonzero(subject.topology.external)
        scene = whole_scene(subject, metric) or layer_scene(
            subject, face_layers(subject, quads), metric, None if walls else iso()
        )
    return dataclasses.replace(scene, view=options.direction or scene.view)
