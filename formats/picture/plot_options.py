"""Options of a picture, from the command line or as arguments in Python, and the request that they make."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence

import numpy as np

from meshdeform_core.errors import CaseError

from .overview import Choice
from .request import Request
from .view import View, Window, along, iso, towards

_IN_SPACE = r"([xyz])=([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


@dataclasses.dataclass(frozen=True)
class PlotOptions:
    """Options as ``meshdeform plot --help`` explains them; ``zoom`` and ``limits`` may be numbers instead of text.

    ``lead`` is what stands before the names in messages: two dashes on the command line.
    """

    metric: str = "f_skew"
    plane: str | None = None
    block: tuple[str, ...] = ()
    select: tuple[str, ...] = ()
    view: str = "auto"
    zoom: str | Sequence[float] | None = None
    before: str | None = None
    arrows: bool = False
    limits: str | Sequence[float] | None = None
    log: bool = False
    lines: bool = True
    lead: str = ""

    def request(self) -> Request:
        """The picture that the options describe.

        Raises
        ------
        CaseError
            When an option is not understood, or options exclude each other.
        """
        lead = self.lead
        if self.plane and self.select:
            raise CaseError(f"{lead}plane and {lead}select exclude each other; give one of them")
        if self.before not in (None, "side", "overlay"):
            raise CaseError(f"{lead}before {self.before!r}: expected side or overlay")
        space = re.fullmatch(_IN_SPACE, self.plane) if self.plane else None
        close = self.zoom if isinstance(self.zoom, str) and self.zoom in ("worst", "walls") else ""
        return Request(
            Choice(self.metric, _limits(self.limits, lead), self.log, self.lines),
            index_plane=_index_plane(self.plane, lead) if self.plane is not None and not space else None,
            space_plane=(space[1], float(space[2])) if space else None,
            blocks=self.block,
            select=self.select,
            view=_view(self.view, lead),
            window=_window(self.zoom, lead) if self.zoom is not None and not close else None,
            zoom=close,
            before=self.before or "",
            arrows=self.arrows,
            lead=lead,
        )


def _limits(given: str | Sequence[float] | None, lead: str) -> tuple[float, float] | None:
    if given is None:
        return None
    # The command line has another name for it than Python, where `range` is a built-in function.
    name = f"{lead}range" if lead else "limits"
    low, high = _numbers(name, given, "low,high", 2)
    if not low < high:
        raise CaseError(f"{name} {given!r}: expected low < high")
    return low, high


def _index_plane(text: str, lead: str) -> tuple[int, int | None]:
    """``k=3`` as (2, 2), ``k=mid`` as (2, None)."""
    match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", text)
    if not match:
        raise CaseError(
            f"{lead}plane {text!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like z=0.25"
        )
    return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1


def _window(given: str | Sequence[float], lead: str) -> Window:
    left, right, bottom, top = _numbers(f"{lead}zoom", given, "worst, walls or left,right,bottom,top", 4)
    if not (left < right and bottom < top):
        raise CaseError(f"{lead}zoom {given!r}: expected left,right,bottom,top with left < right, bottom < top")
    return left, right, bottom, top


def _view(text: str, lead: str) -> View | None:
    """A view by name or direction; ``None`` for ``auto``."""
    if text == "auto":
        return None
    if text == "iso":
        return iso()
    if text in ("x", "y", "z"):
        return along(text)
    direction = np.array(_numbers(f"{lead}view", text, "auto, x, y, z, iso or a direction like 1,-1,0.5", 3))
    if not direction.any():
        raise CaseError(f"{lead}view {text!r}: a direction has a length")
    return towards(direction)


def _numbers(name: str, given: str | Sequence[float], expected: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in (given.split(",") if isinstance(given, str) else given))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise CaseError(f"{name} {given!r}: expected {expected}")
    return numbers
