"""What a picture shows in the words of a user: an option of the command line, an argument in Python."""

from __future__ import annotations

import dataclasses
import fnmatch
import math
import re
from collections.abc import Sequence

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.planes import Plane

from .overview import Choice
from .request import Request
from .view import View, Window, along, iso, towards


@dataclasses.dataclass(frozen=True)
class Wish:
    """A :class:`Request` in words; texts as ``meshdeform plot --help`` explains them.

    ``lead`` is what stands before the names in messages: two dashes on the command line.
    """

    metric: str = "f_skew"
    plane: str | None = None
    block: tuple[str, ...] = ()
    select: tuple[str, ...] = ()
    view: str = "auto"
    zoom: str | None = None
    before: str | None = None
    arrows: bool = False
    limits: str | None = None
    log: bool = False
    lines: bool = True
    lead: str = ""

    def request(self) -> Request:
        """What can be said without the grid.

        Raises
        ------
        CaseError
            When words are not understood or exclude each other.
        """
        if self.plane and self.select:
            raise CaseError(f"{self.lead}plane and {self.lead}select exclude each other; give one of them")
        limits = self._numbers("range", self.limits, "low,high", 2) if self.limits else None
        if limits and not limits[0] < limits[1]:
            raise CaseError(f"{self.lead}range {self.limits!r}: expected low < high")
        if self.before not in (None, "side", "overlay"):
            raise CaseError(f"{self.lead}before {self.before!r}: expected side or overlay")
        close = self.zoom if self.zoom in ("worst", "walls") else ""
        return Request(
            Choice(self.metric, None if limits is None else (limits[0], limits[1]), self.log, self.lines),
            index_plane=self._index_plane(),
            select=self.select,
            view=self._view(),
            window=self._window(self.zoom) if self.zoom and not close else None,
            zoom=close,
            before=self.before or "",
            arrows=self.arrows,
        )

    def complete(self, request: Request, grid: Grid) -> Request:
        """What needs the grid: planes in space and blocks by name.

        Raises
        ------
        CaseError
            When there is no such plane or block.
        """
        if self.plane and request.index_plane is None:
            axis, at = self.plane.split("=")
            request = dataclasses.replace(request, space_plane=self._space_plane(grid, axis, float(at)))
        if self.block:
            request = dataclasses.replace(request, blocks=self._blocks(grid.names))
        return request

    def _index_plane(self) -> tuple[int, int | None] | None:
        """``k=3`` as (2, 2), ``mid`` as ``None``; nothing for a plane in space like ``z=0.25``."""
        text = self.plane
        if text is None or re.fullmatch(r"[xyz]=[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
            return None
        match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", text)
        if not match:
            raise CaseError(
                f"{self.lead}plane {text!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like z=0.25"
            )
        return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1

    def _window(self, text: str) -> Window:
        left, right, bottom, top = self._numbers("zoom", text, "worst, walls or left,right,bottom,top", 4)
        if not (left < right and bottom < top):
            raise CaseError(f"{self.lead}zoom {text!r}: expected left,right,bottom,top with left < right, bottom < top")
        return left, right, bottom, top

    def _view(self) -> View | None:
        """A view by name or direction; nothing for ``auto``."""
        if self.view == "auto":
            return None
        if self.view == "iso":
            return iso()
        if self.view in ("x", "y", "z"):
            return along(self.view)
        expected = "auto, x, y, z, iso or a direction like 1,-1,0.5"
        direction = np.array(self._numbers("view", self.view, expected, 3))
        if not direction.any():
            raise CaseError(f"{self.lead}view {self.view!r}: a direction has a length")
        return towards(direction)

    def _numbers(self, name: str, text: str, expected: str, count: int) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise CaseError(f"{self.lead}{name} {text!r}: expected {expected}")
        return numbers

    def _blocks(self, names: Sequence[str]) -> tuple[int, ...]:
        """Numbers of the blocks whose names match the patterns."""
        found: list[int] = []
        for pattern in self.block:
            matching = [n for n, name in enumerate(names) if fnmatch.fnmatchcase(name, pattern)]
            if not matching:
                raise CaseError(f"{self.lead}block {pattern!r} matches no block; blocks are {', '.join(names[:12])}")
            found += matching
        return tuple(dict.fromkeys(found))

    def _space_plane(self, grid: Grid, axis: str, at: float) -> Plane:
        """The plane ``axis`` (``x``, ``y`` or ``z``) = ``at``."""
        number = "xyz".index(axis)
        low, high = float(grid.points[:, number].min()), float(grid.points[:, number].max())
        if grid.dimension == 2:
            raise CaseError(f"a 2-D grid cannot be cut; leave {self.lead}plane out to draw the whole grid")
        tiny = 1e-9 * float(np.ptp(grid.points, axis=0).max())
        if not low - tiny <= at <= high + tiny:
            raise CaseError(f"no part of the grid lies at {axis} = {at:g}; it spans {axis} = {low:.6g} to {high:.6g}")
        normal = np.eye(3)[number]
        return Plane(at * normal, normal)
