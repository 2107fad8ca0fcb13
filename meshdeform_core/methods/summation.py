"""The choice between exact and fast sums, the same for all scattered-data methods."""

from __future__ import annotations

from ..errors import MethodError
from .base import Setting
from .options import choose, positive

_FAST_PAIRS = 2e8
_FAST_SOURCES = 2000


def check_summation(method: str, summation: str, tolerance: float) -> None:
    """Refuse a wrong ``summation`` or ``summation_tolerance`` of a method."""
    choose(f"{method}.summation", summation, ("auto", "exact", "fast"))
    positive(f"{method}.summation_tolerance", tolerance)
    if not 1e-8 <= tolerance <= 0.1:
        raise MethodError(f"method.{method}.summation_tolerance = {tolerance:g}; expected 1e-8 to 0.1 of a cell")


def fast_pays(summation: str, n_targets: int, n_sources: int) -> tuple[bool, Setting]:
    """Whether to sum fast, and the setting to report; exact sums take about 0.2 s for the 2e8 pairs of the limit."""
    pairs = n_targets * n_sources
    fast = summation == "fast" or (summation == "auto" and pairs > _FAST_PAIRS and n_sources > _FAST_SOURCES)
    reason = f"{n_targets:,} nodes with {n_sources:,} sources" if summation == "auto" else ""
    return fast, Setting("fast" if fast else "exact", reason)
