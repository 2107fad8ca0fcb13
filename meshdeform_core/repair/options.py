"""User options of repairs, and limits on the time and the work of the repairs and attempts of a motion."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from ..errors import CaseError
from ..parallel import ONE_PROCESS, Ranks
from ..wording import literal

if TYPE_CHECKING:
    from ..grid import Grid

Mode = Literal["auto", "off", "polish"]
Effort = Literal["hasty", "quick", "patient", "all"]
"""How long a repair tries: ``hasty`` where no valid grid exists; ``all``: first quick, then patient."""
MODES: tuple[str, ...] = get_args(Mode)
_PER_NODE, _FEWEST = 600.0, 35_000
"""Work allowed per node (60 s per 100,000 nodes), and the smallest number of nodes used for it."""
_VALID, _VALID_PER_NODE = 250_000.0, 35.0
"""Work allowed for the repair of a valid grid: 12 times what the default method takes to be prepared and to move its
nodes, 20 ms and 3 microseconds per node (studies/repairs.py)."""
_SQUEEZED = 0.22
"""Where a valid grid has a smaller relative Jacobian than this, it may take more in proportion, up to what an invalid
one may: a motion that folds cells passes through such grids, and jumps where their repair is cut (studies/jumps.py)."""
_PART = 1.0 / 2.0
"""The part of the work left that one repair may take: where it fails, smaller steps may do (studies/repairs.py)."""


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


class Limit:
    """Wall-clock time, in seconds from its creation, and work.

    Work is counted, not measured, so that results depend on neither the machine nor its load. Its unit is about a
    microsecond of one core. What is spent within a limit made from another one is also spent of that one;
    ``spent`` is all of it. ``ranks`` share the work.
    """

    def __init__(
        self, seconds: float = float("inf"), work: float = float("inf"), whole: Limit | None = None,
        ranks: Ranks | None = None,
    ):  # fmt: skip
        self.seconds, self._most, self._whole, self.spent = seconds, work, whole, 0.0
        self.ranks: Ranks = ranks or (whole.ranks if whole else ONE_PROCESS)
        self._end: float = min(clock.monotonic() + seconds, whole._end if whole else float("inf"))

    @classmethod
    def of(cls, grid: Grid, seconds: float) -> Limit:
        """The limit for a motion of a grid, for the ranks that hold it."""
        return cls(seconds, _PER_NODE * max(grid.n_nodes, _FEWEST), ranks=grid.nodes.ranks)

    def of_one_rank(self) -> Limit:
        """What is left, for one rank alone; what it spends is to be counted on all."""
        return Limit(self._end - clock.monotonic(), self._most - self.spent)

    def of_repair(self, n_nodes: int, smallest_ratio: float) -> Limit:
        """The limit for one repair of a grid with this smallest relative Jacobian, 0 if it is invalid: at most a part
        of the work that is left."""
        whole, part = _PART * (self._most - self.spent), min(smallest_ratio / _SQUEEZED, 1.0)
        work = _VALID + _VALID_PER_NODE * n_nodes
        return Limit(work=work / part if work < part * whole else whole, whole=self)

    def spend(self, work: float) -> None:
        """Count work done."""
        self.spent += work
        if self._whole:
            self._whole.spend(work)

    def affords(self, work: float) -> int:
        """How often this work may still be done."""
        return int(max(0.0, min((self._most - self.spent) / work, 1e9)))

    @property
    def exhausted(self) -> bool:
        """Whether all work is spent on some rank; a collective call with the same answer on all."""
        return self.ranks.largest(self.spent - self._most) >= 0.0

    @property
    def reached(self) -> bool:
        """Whether the work is spent or the time is over on some rank; a collective call with the same answer on all."""
        return self.exhausted or self.ranks.largest(clock.monotonic() - self._end) >= 0.0
