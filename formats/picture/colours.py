"""Colours of values, chosen so that colour-blind people can distinguish them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray

from .scene import Facets
from .subject import METRICS, Metric

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

INVALID_COLOUR = (0.90, 0.00, 0.42)
"""Not in any of the colour maps; colour-blind people can distinguish it from them by lightness or hue."""
_REACHES = (0.01, 0.02, 0.05)
"""Shortest ranges for metrics with a fixed end; longer ones are multiples of a tenth."""
SEQUENTIAL, DIVERGING = "viridis", "PuOr"
NO_VALUE = (0.86, 0.86, 0.87)


@dataclass(frozen=True)
class Scale:
    """Mapping of values to colours.

    ``low`` and ``high`` are the ends, ``logarithmic`` how they are spaced between them, ``extended`` which ends values
    exceed (``neither``, ``min``, ``max``, ``both``, as for matplotlib's colour bars).
    """

    metric: str
    low: float
    high: float
    logarithmic: bool = False
    extended: str = "neither"

    @property
    def mappable(self) -> ScalarMappable:
        """Norm and colour map, for matplotlib's colour bars."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm, Normalize

        colours = DIVERGING if METRICS[self.metric].diverging else SEQUENTIAL
        return ScalarMappable((LogNorm if self.logarithmic else Normalize)(self.low, self.high, clip=True), colours)

    def colours(self, facets: Facets) -> FloatArray:
        """RGB (n, 3) of polygons by value; invalid cells have a colour of their own, those without a value are grey."""
        known = np.isfinite(facets.values)
        colours = np.asarray(self.mappable.to_rgba(np.where(known, facets.values, self.low)))[:, :3]
        colours[~known] = NO_VALUE
        colours[facets.bad] = INVALID_COLOUR
        return colours


@dataclass(frozen=True)
class Choice:
    """Metric and scale of the colours.

    ``limits`` of the colours, ``logarithmic`` scale.
    """

    metric: str = "f_skew"
    limits: tuple[float, float] | None = None
    logarithmic: bool = False

    def scale(self, *values: FloatArray) -> Scale:
        """Colours for all values (n,) together: between the limits, else the metric's own, else the ends of the values.

        Raises CaseError when a logarithmic scale is requested but no value is positive.
        """
        known, finite = METRICS[self.metric], np.concatenate(values)
        finite = finite[np.isfinite(finite)]
        if self.logarithmic:
            finite = finite[finite > 0]
            if finite.size == 0 or (self.limits is not None and self.limits[0] <= 0):
                raise CaseError(f"--log: {self.metric} has no positive value, or the range does not begin above zero")
        low, high = self.limits or _ends_of_colours(finite, known, self.logarithmic)
        beyond = bool((finite < low - 1e-12 * abs(low)).any()), bool((finite > high + 1e-12 * abs(high)).any())
        extended = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
        return Scale(self.metric, low, high, self.logarithmic, extended)


def _ends_of_colours(finite: FloatArray, known: Metric, logarithmic: bool) -> tuple[float, float]:
    """The ends of the colours for values (n,)."""
    if known.limits is not None and not logarithmic:
        fixed = known.limits
        # The good end stays; the other follows the data, in steps that make round labels.
        worst = fixed[1] - max(float(finite.min()) if finite.size else fixed[0], fixed[0])
        reach = next((step for step in _REACHES if worst <= step + 1e-9), np.ceil(10 * worst - 1e-9) / 10)
        return round(fixed[1] - reach, 2), fixed[1]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if known.diverging:
        # The neutral value, 1, in the middle.
        if logarithmic:
            factor = max(high, 1.0 / low, 1.001)
            return 1.0 / factor, factor
        reach = max(abs(high - 1.0), abs(1.0 - low), 1e-3)
        return 1.0 - reach, 1.0 + reach
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        pad = 0.5 * abs(low) or 0.5
        return (0.5 * low, 2 * low) if logarithmic else (low - pad, high + pad)
    return low, high
