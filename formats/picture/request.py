"""A picture as requested by the user: options from the command line or Python, and the page that they describe."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.numerics.arrays import extent

from .colours import Choice
from .overview import overview, worst_cells
from .page import Page, Panel
from .scene import Scene, cut_scene, face_layers, index_layers, layer_scene, whole_scene
from .subject import Subject, quads_of_surfaces, worst_cell
from .view import View, Window, along, iso, towards

_IN_SPACE = r"([xyz])=([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


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
        _ = self.choice, self.index_plane, self.direction, self.window

    @property
    def plain(self) -> bool:
        """Whether only the colouring is specified."""
        return not (self.plane or self.select or self.zoom) and self.view == "auto"

    @cached_property
    def choice(self) -> Choice:
        """What colours the cells."""
        if self.limits is None:
            return Choice(self.metric, None, self.log)
        # The command line has another name for it than Python, where `range` is a built-in function.
        name = f"{self.lead}range" if self.lead else "limits"
        low, high = _numbers(name, self.limits, "low,high", 2)
        if not low < high:
            raise CaseError(f"{name} {self.limits!r}: expected low < high")
        return Choice(self.metric, (low, high), self.log)

    @property
    def space_plane(self) -> tuple[str, float] | None:
        """Coordinate axis and position of a plane through all blocks."""
        match = re.fullmatch(_IN_SPACE, self.plane or "")
        return (match[1], float(match[2])) if match else None

    @property
    def index_plane(self) -> tuple[int, int | None] | None:
        """Index axis and node (0-based, ``None``: the middle): ``k=3`` is (2, 2), ``k=mid`` (2, None)."""
        if self.plane is None or self.space_plane:
            return None
        match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", self.plane)
        if not match:
            raise CaseError(
                f"{self.lead}plane {self.plane!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like "
                f"z=0.25"
            )
        return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1

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
    choice = options.choice
    if options.plain:
        return overview(subject, choice, title)
    if options.close == "worst":
        block, cell = worst_cell(subject, choice.metric)
        # The undeformed grid compared with itself, for measures that compare.
        old = Subject(subject.reference, subject.topology, subject.reference) if subject.reference else subject
        page = worst_cells(old, subject, block, cell, choice)
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
    return Page.of([Panel(scene, window)], choice, title)


def _scene(subject: Subject, options: PlotOptions) -> Scene:
    """The part of a grid that options name, in the direction that they ask for."""
    metric = options.choice.metric
    if options.select:
        if subject.grid.dimension == 2:
            raise CaseError("a 2-D grid has no surfaces to select; leave --select out to draw the whole grid")
        quads = select_quads(subject.reference or subject.grid, subject.topology, options.select, "plot")
        scene = layer_scene(subject, face_layers(subject, quads), metric)
    elif options.space_plane is not None:
        axis, at = options.space_plane
        if subject.grid.dimension == 2:
            raise CaseError(f"a 2-D grid cannot be cut; leave {options.lead}plane out to draw the whole grid")
        normal = np.eye(3)["xyz".index(axis)]
        low, high = (float(end @ normal) for end in extent(subject.grid.points))
        tiny = 1e-9 * subject.size
        if not low - tiny <= at <= high + tiny:
            raise CaseError(f"no part of the grid lies at {axis} = {at:g}; it spans {axis} = {low:.6g} to {high:.6g}")
        scene = cut_scene(subject, Plane(at * normal, normal), metric)
    elif options.index_plane is not None:
        scene = layer_scene(subject, index_layers(subject.grid, *options.index_plane), metric)
    else:
        walls = subject.wall_surfaces
        quads = quads_of_surfaces(walls) if walls else np.flatnonzero(subject.topology.external)
        scene = whole_scene(subject, metric) or layer_scene(
            subject, face_layers(subject, quads), metric, None if walls else iso()
        )
    return dataclasses.replace(scene, view=options.direction or scene.view)
