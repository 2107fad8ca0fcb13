"""Newton's method for the foldover-free energy: first until no sample is inverted, then against the worst ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..numerics.parallel import for_chunks
from .energy import Samples, energy_of_cells
from .system import NewtonSystem

_CELLS = 4096
_TOLERANCE = 1e-2
_MOST_ITERATIONS = 300
_SMALLEST_STEP = 1e-4
# Sufficient decrease of a line search (Armijo).
_DECREASE = 1e-4


@dataclass
class Region:
    """Cells whose nodes are moved, with nodes of their own numbering.

    Attributes
    ----------
    numbers : (m,) cell numbers of the grid
    start : (n, 3) undeformed coordinates
    cells : (m, 8) nodes of hexahedra, (m, 4) of quadrilaterals, in the order of :func:`.energy.cell_samples`
    mask : (m,) int64, bit s set where sample point s counts
    samples : the sample points
    normal : (3,) unit normal of the plane of a 2-D grid, else zero
    unknowns : of every node: number of its unknown or -1 (n,), ``frame`` (n, 3, 3) with d = frame @ u, and whether
        that is the identity (n,)
    freedom : (n_unknowns, 3, 3) projectors on the directions in which unknowns may move
    """

    numbers: np.ndarray
    start: np.ndarray
    cells: np.ndarray
    mask: np.ndarray
    samples: Samples
    normal: np.ndarray
    unknowns: tuple[np.ndarray, np.ndarray, np.ndarray]
    freedom: np.ndarray

    @property
    def n_unknowns(self) -> int:
        return len(self.freedom)

    @property
    def energy(self) -> tuple:
        """The arguments of the loops of :mod:`.energy` that do not change."""
        return self.start, self.cells, self.mask, self.samples, self.normal

    def moved(self, x: np.ndarray, step: np.ndarray, length: float) -> np.ndarray:
        """Coordinates after ``length`` times the step (n_unknowns, 3) of the unknowns."""
        number, frame, plain = self.unknowns
        free = number >= 0
        move = step[number[free]]
        turned = ~plain[free]
        move[turned] = np.einsum("nij,nj->ni", frame[free][turned], move[turned])
        result = x.copy()
        result[free] += length * move
        return result


@dataclass(frozen=True)
class State:
    """Coordinates with the energy there, its smallest determinant and its largest density."""

    x: np.ndarray
    energy: float
    lowest: float
    highest: float


@dataclass
class Untangler:
    """Moves the unknowns of a region from coordinates ``x`` (n, 3)."""

    region: Region
    x: np.ndarray
    steps: int = 0
    progress: Callable[[int, int], None] | None = None

    def __post_init__(self) -> None:
        self._system = NewtonSystem(self.region)

    def state(self, x: np.ndarray, eps: float, t: float = 0.0) -> State:
        n = len(self.region.cells)
        parts = np.empty((-(-n // _CELLS), 3))

        def work(low: int, high: int) -> None:
            parts[low // _CELLS] = energy_of_cells(x, *self.region.energy, eps, t, low, high)

        for_chunks(work, n, _CELLS)
        return State(x, parts[:, 0].sum(), parts[:, 1].min(), parts[:, 2].max())

    def untangle(self, margin: float, most: int) -> bool:
        """Newton steps until every determinant is above ``margin`` (> 0); at most ``most``.

        The regularisation falls by the rule of Garanzha et al. 2021 (section 2.3).
        """
        eps = 1.0
        for _ in range(most):
            now = self.state(self.x, eps)
            if now.lowest > margin:
                return True
            after = self._step(now, eps, 0.0)
            self.x = after.x
            change = max(0.1, 1.0 - after.energy / now.energy)
            eps = _next_eps(eps, after.lowest, change)
        return self.state(self.x, eps).lowest > margin

    def improve(self, most: int) -> None:
        """Newton steps against the largest density from a valid start, until it falls by less than 2 % in two steps."""
        now = self.state(self.x, 0.0)
        past = [now.highest]
        for _ in range(most):
            t = 0.8 / now.highest
            barrier = self.state(now.x, 0.0, t)
            after = self._step(barrier, 0.0, t)
            now = self.state(after.x, 0.0)
            past.append(now.highest)
            if len(past) > 2 and past[-1] > 0.98 * past[-3]:
                break
        self.x = now.x

    def _step(self, now: State, eps: float, t: float) -> State:
        system = self._system
        system.fill(now.x, eps, t)
        step, _ = system.direction(_TOLERANCE, _MOST_ITERATIONS)
        slope = float(np.vdot(step, system.gradient))
        self.steps += 1
        length = 1.0
        while length > _SMALLEST_STEP:
            after = self.state(self.region.moved(now.x, step, length), eps, t)
            if after.energy <= now.energy + _DECREASE * length * slope:
                return after
            length /= 2
        return now


def _next_eps(eps: float, lowest: float, change: float) -> float:
    """The regularisation with which chi of the smallest determinant is ``1 - change`` times what it is now."""
    root = np.sqrt(eps * eps + lowest * lowest)
    chi = 0.5 * (lowest + root) if lowest > 0 else 0.5 * eps * eps / (root - lowest)
    goal = (1.0 - change) * chi
    return 2.0 * float(np.sqrt(goal * (goal - lowest))) if lowest < goal else 1e-10
