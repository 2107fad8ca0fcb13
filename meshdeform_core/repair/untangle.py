"""Newton's method for the foldover-free energy: first until no sample is inverted, then to improve the worst ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray
from ..parallel import for_chunks
from .newton import NewtonSystem
from .region import Region

_ELEMENTS = 4096
_TOLERANCE = 3e-2
_MOST_ITERATIONS = 200
_FIRST_EPS = 0.5
# A determinant that stays below -_LOCKED eps while eps falls has nowhere to go in this region.
_LOCKED = 100.0
_SLOWEST = 0.4
# Barriers as shares of the largest density, a step that lowers it by less than that, and where it is low enough.
_BARRIERS = (0.0, 0.5, 0.8)
_STALLED = 0.95
_GOOD = 4.0
_SMALLEST_STEP = 1e-4
# Sufficient decrease of a line search (Armijo).
_DECREASE = 1e-4


@dataclass(frozen=True)
class State:
    """Coordinates with the energy there, its smallest determinant and its largest density."""

    x: FloatArray
    energy: float
    lowest: float
    highest: float


@dataclass
class Untangler:
    """Moves the unknowns of a region from coordinates ``x`` (n, 3)."""

    region: Region
    x: FloatArray
    steps: int = 0
    progress: Callable[[str, int, int], None] | None = None

    def __post_init__(self) -> None:
        self._system = NewtonSystem(self.region)

    def state(self, x: FloatArray, eps: float, t: float = 0.0) -> State:
        n = len(self.region.energy.nodes)
        parts = np.empty((-(-n // _ELEMENTS), 3))

        def work(low: int, high: int) -> None:
            parts[low // _ELEMENTS] = self.region.energy.sum(x, eps, t, low, high)

        for_chunks(work, n, _ELEMENTS)
        return State(x, parts[:, 0].sum(), parts[:, 1].min(), parts[:, 2].max())

    def untangle(self, most: int) -> bool:
        """Newton steps until every determinant is positive; at most ``most``.

        The regularisation falls as in Garanzha et al. 2021 (section 2.3), but by at least 40 % instead of 10 % where
        the energy hardly changes any more: a few extra steps at the end cost less than many on the way.
        """
        eps = _FIRST_EPS
        for step in range(most + 1):
            now = self.state(self.x, eps)
            if now.lowest > 0.0:
                return True
            if step == most:
                break
            if now.lowest < -_LOCKED * eps:
                break
            self._tell(step, most)
            after = self._step(now, eps, 0.0)
            self.x = after.x
            eps = _next_eps(eps, after.lowest, max(_SLOWEST, 1.0 - after.energy / now.energy))
        return False

    def improve(self, most: int) -> float:
        """Newton steps that lower the largest density f from a valid start, while they help; returns it.

        First plain ones, then with a barrier ever closer above the largest density.
        """
        now, barrier = self.state(self.x, 0.0), 0
        for step in range(most):
            if now.highest < _GOOD or barrier == len(_BARRIERS):
                break
            self._tell(step, most)
            t = _BARRIERS[barrier] / now.highest
            after = self._step(self.state(now.x, 0.0, t), 0.0, t)
            before, now = now.highest, self.state(after.x, 0.0)
            if now.highest > _STALLED * before:
                barrier += 1
        self.x = now.x
        return now.highest

    def _tell(self, done: int, most: int) -> None:
        if self.progress:
            self.progress("repair", done, most)

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
