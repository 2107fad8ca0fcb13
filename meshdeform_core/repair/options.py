"""User options of repairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from ..errors import CaseError
from ..wording import literal

Mode = Literal["auto", "off", "polish"]
Effort = Literal["hasty", "quick", "patient", "all"]
"""How long a repair tries: ``hasty`` where no valid grid exists; ``all``: first quick, then patient."""
MODES: tuple[str, ...] = get_args(Mode)


@dataclass(frozen=True)
class RepairOptions:
    """When a deformed grid is repaired.

    Attributes
    ----------
    mode : ``auto``: when cells are invalid or weak (sheared or stretched beyond the onset of repairs); ``off``: never;
        ``polish``: also to improve the worst cells of a valid grid
    time_limit : no repair, Newton step or further attempt begins after this many seconds
    min_jacobian : cells with a corner below this fraction of its undeformed Jacobian count as invalid; 0 <= R < 1
    """

    mode: Mode = "auto"
    min_jacobian: float = 0.0
    time_limit: float = 1800.0

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise CaseError(f"repair = {literal(self.mode)} is unknown; known are {', '.join(MODES)}")
        if not 0.0 <= self.min_jacobian < 1.0:
            raise CaseError(
                f"min_jacobian = {literal(self.min_jacobian)}; expected a share of the undeformed Jacobian, 0 <= R < 1"
            )
        if not self.time_limit > 0.0:
            raise CaseError(f"time_limit = {literal(self.time_limit)}; expected seconds > 0")
