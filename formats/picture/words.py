"""The words of a user, options of the command line or arguments in Python, as a request for a picture."""

from __future__ import annotations

import math
import re

import numpy as np

from meshdeform_core.errors import CaseError

from .overview import Choice
from .request import Request
from .view import View, Window, along, iso, towards

_IN_SPACE = r"([xyz])=([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


def request_of(  # noqa: PLR0913 - one for each option
    *,
    metric: str = "f_skew",
    plane: str | None = None,
    block: tuple[str, ...] = (),
    select: tuple[str, ...] = (),
    view: str = "auto",
    zoom: str | None = None,
    before: str | None = None,
    arrows: bool = False,
    limits: str | None = None,
    log: bool = False,
    lines: bool = True,
    lead: str = "",
) -> Request:
    """A request in words, as ``meshdeform plot --help`` explains them.

    ``lead`` is what stands before the names in messages: two dashes on the command line.

    Raises
    ------
    CaseError
        When words are not understood or exclude each other.
    """
    if plane and select:
        raise CaseError(f"{lead}plane and {lead}select exclude each other; give one of them")
    if before not in (None, "side", "overlay"):
        raise CaseError(f"{lead}before {before!r}: expected side or overlay")
    space = re.fullmatch(_IN_SPACE, plane) if plane else None
    close = zoom if zoom in ("worst", "walls") else ""
    return Request(
        Choice(metric, _limits(limits, lead), log, lines),
        index_plane=_index_plane(plane, lead) if plane is not None and not space else None,
        space_plane=(space[1], float(space[2])) if space else None,
        blocks=block,
        select=select,
        view=_view(view, lead),
        window=_window(zoom, lead) if zoom and not close else None,
        zoom=close,
        before=before or "",
        arrows=arrows,
        lead=lead,
    )


def _limits(text: str | None, lead: str) -> tuple[float, float] | None:
    if not text:
        return None
    low, high = _numbers(f"{lead}range", text, "low,high", 2)
    if not low < high:
        raise CaseError(f"{lead}range {text!r}: expected low < high")
    return low, high


def _index_plane(text: str, lead: str) -> tuple[int, int | None]:
    """``k=3`` as (2, 2), ``k=mid`` as (2, None)."""
    match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", text)
    if not match:
        raise CaseError(
            f"{lead}plane {text!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like z=0.25"
        )
    return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1


def _window(text: str, lead: str) -> Window:
    left, right, bottom, top = _numbers(f"{lead}zoom", text, "worst, walls or left,right,bottom,top", 4)
    if not (left < right and bottom < top):
        raise CaseError(f"{lead}zoom {text!r}: expected left,right,bottom,top with left < right, bottom < top")
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


def _numbers(name: str, text: str, expected: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise CaseError(f"{name} {text!r}: expected {expected}")
    return numbers
