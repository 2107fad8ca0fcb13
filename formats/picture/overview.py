"""What is shown where nothing is specified, of a grid and of two, before and after; and as options ask."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, Grid, IntArray, Shape
from meshdeform_core.grid.faces import Role
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.selection import select_quads

from .page import Page, Panel, Scale
from .scene import (
    Layer,
    Scene,
    View,
    Window,
    along,
    cut_scene,
    face_layers,
    facing,
    index_layers,
    iso,
    layer_facets,
    layer_scene,
    onto_walls,
    towards,
    wall_edges,
    whole_scene,
)
from .subject import Subject, quads_of_surfaces, worst_cell

_SMALL = 0.3
"""Walls smaller than this fraction of the picture along its larger side get a close-up."""
_TALL, _FLAT = 1.15, 0.05
_PLANE = r"([ijk])=(mid|[1-9]\d*)|([xyz])=([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


def overview(subject: Subject, scale: Scale, title: str = "") -> Page:
    """A plane or extruded grid in plan view; else the walls and a cut, or the outside, in space.

    Small walls have a close-up.
    """
    metric, bodies = scale.metric, subject.outside.bodies
    scene = whole_scene(subject, metric)
    if scene is not None:
        panels = [Panel(scene, scene.view.window(scene.facets.corners, 0.02).shaped(_FLAT, _TALL))]
        if subject.wall_surfaces:
            near = scene.view.window(subject.corners(subject.wall_surfaces), 0.35).shaped(0.5, _TALL)
            if near.larger_side <= _SMALL * panels[0].window.larger_side:
                panels = [dataclasses.replace(panels[0], title="whole grid"), Panel(scene, near, "close-up")]
        return Page.of(panels, scale, title)
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
    near = cut.view.window(points, 0.3).within(cut.view.window(cut.facets.corners, 0.0)).shaped(0.4, _TALL)
    axis = int(np.argmax(np.abs(plane.normal)))
    where = f"cut {'xyz'[axis]} = {plane.point[axis]:.4g}"
    return Page.of([Panel(walls, around, "walls"), Panel(cut, near, where)], scale, title)


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
    window = before.view.window(before.facets.corners, 0.02).shaped(0.3, 1.0)
    points = np.concatenate([subject.corners(old.outside.bodies) for subject in (old, new)])
    if points.size:
        window = before.view.window(points, 0.6).within(window).shaped(0.5, 0.9)
    return _twins([before, after], (window, window), scale)


def worst_cells(old: Subject, new: Subject, block: int, cell: Shape, scale: Scale | None = None) -> Page:
    """The surroundings of a cell (0-based ``cell`` of ``block``) before and after, on the same scale; in space those in
    an index plane of the block."""
    scale = scale or Scale()
    scenes = [scene for scene in (whole_scene(each, scale.metric) for each in (old, new)) if scene is not None]
    if len(scenes) < 2:
        axis, normal = telling_plane(old.grid, new.grid, block, cell)
        layer, view = [Layer(block, axis, cell[axis])], facing(normal)
        scenes = [Scene(layer_facets(each, layer, scale.metric), view) for each in (old, new)]
    # Windows of the same size that show half of the nodes within seven cells.
    own, near = [slice(at, at + 2) for at in cell], [slice(max(at - 7, 0), at + 9) for at in cell]
    view, centers, reach = scenes[0].view, [], 0.0
    for grid in (old.grid, new.grid):
        center = view.project(grid.few(block, own).reshape(-1, 3).mean(axis=0))[:2]
        around = view.project(grid.few(block, near).reshape(-1, 3))[:, :2]
        reach = max(reach, float(np.median(np.abs(around - center).max(axis=1))))
        centers.append(center.tolist())
    return _twins(scenes, [Window(x - reach, x + reach, y - 0.8 * reach, y + 0.8 * reach) for x, y in centers], scale)


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

    @property
    def scale(self) -> Scale:
        """What colours the cells."""
        # The command line has another name for it than Python, where `range` is a built-in function.
        name = f"{self.lead}range" if self.lead else "limits"
        expected = "low,high with low < high"
        ends = () if self.limits is None else _numbers(name, self.limits, expected, 2)
        return Scale(self.metric, (ends[0], ends[1]) if ends else None, self.log)

    @property
    def layer(self) -> tuple[str, float | None]:
        """Axis and place of the plane: ``k=3`` is ("k", 3), ``k=mid`` ("k", None), ``z=0.25`` ("z", 0.25)."""
        if self.plane is None:
            return "", None
        match = re.fullmatch(_PLANE, self.plane)
        if not match:
            raise CaseError(
                f"{self.lead}plane {self.plane!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like "
                f"z=0.25"
            )
        index, node, axis, at = match.groups()
        return index or axis, None if node == "mid" else float(node or at)

    @property
    def window(self) -> Window | None:
        """A part of the picture by numbers."""
        if not self.zoom or self.zoom in ("worst", "walls"):
            return None
        expected = "worst, walls or left,right,bottom,top with left < right, bottom < top"
        return Window(*_numbers(f"{self.lead}zoom", self.zoom, expected, 4))

    @property
    def direction(self) -> View | None:
        """The view by name or direction; ``None`` for ``auto``."""
        if self.view in ("auto", "iso"):
            return iso() if self.view == "iso" else None
        if self.view in ("x", "y", "z"):
            return along(self.view)
        return towards(
            np.array(_numbers(f"{self.lead}view", self.view, "auto, x, y, z, iso or a direction like 1,-1,0.5", 3))
        )


def _numbers(name: str, given: str | Sequence[float], expected: str, count: int) -> tuple[float, ...]:
    """The numbers of an option: a direction, which has a length, or two or four ends of intervals."""
    try:
        numbers = tuple(float(part) for part in (given.split(",") if isinstance(given, str) else given))
    except (TypeError, ValueError):
        numbers = ()
    sound = (
        any(numbers) if count == 3 else all(low < high for low, high in zip(numbers[::2], numbers[1::2], strict=False))
    )
    if len(numbers) != count or not sound or not all(map(math.isfinite, numbers)):
        raise CaseError(f"{name} {given!r}: expected {expected}")
    return numbers


def picture(subject: Subject, options: PlotOptions, title: str = "") -> Page:
    """The page that options describe.

    Raises CaseError when a plane does not meet the grid, or a name matches nothing.
    """
    scale = options.scale
    if options.plain:
        return overview(subject, scale, title)
    if options.zoom == "worst":
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
    elif options.zoom == "walls":
        if not subject.wall_surfaces:
            raise CaseError(f"{options.lead}zoom walls: no wall is known; see `meshdeform info`")
        window = scene.view.window(subject.corners(subject.wall_surfaces), 0.3).shaped(0.4, 1.2)
    else:
        window = scene.view.window(scene.facets.corners, 0.03).shaped(0.05, 1.4)
    return Page.of([Panel(scene, window)], scale, title)


def _scene(subject: Subject, options: PlotOptions) -> Scene:
    """The part of a grid that options name, in the direction that they ask for."""
    metric, (axis, at) = options.scale.metric, options.layer
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
        scene = cut_scene(subject, Plane(at * normal, normal), metric)
    else:
        walls = subject.wall_surfaces
        quads = quads_of_surfaces(walls) if walls else np.flatnonzero(subject.topology.external)
        scene = whole_scene(subject, metric) or layer_scene(
            subject, face_layers(subject, quads), metric, None if walls else iso()
        )
    return dataclasses.replace(scene, view=options.direction or scene.view)
