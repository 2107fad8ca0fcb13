"""Newton's method for the foldover-free energy: first until no sample is inverted, then to improve the worst ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray
from ..parallel import for_chunks
from .newton import NewtonSystem
from .region import FIRM, GUARDED, Penalty, Region

_ELEMENTS = 4096
_TOLERANCE = 3e-2
_MOST_ITERATIONS = 200
# A determinant that stays below -_LOCKED eps while eps falls has nowhere to go in this region.
_LOCKED = 100.0
# Where the largest density is low enough; it stalls if _WINDOW steps do not lower it below that share.
_GOOD = 2.6
_WINDOW, _STALLED = 5, 0.95
# Plain steps after untangling.
_SETTLING = 3
# Elements of a shape below _WEAKEST times the worst are pressed, in at most _SHAPING steps, until _IDLE of these have
# not improved the worst by the factor _HELPS. The largest density may grow by the part _LOOSE of its excess, the
# smallest determinant may fall to the part _KEPT.
_WEAKEST, _SHAPING, _IDLE = 1.15, 8, 2
_HELPS, _LOOSE, _KEPT = 1.01, 0.02, 0.995
# By which part of the distance to the largest density a barrier approaches it at least.
_CLOSER = 0.3
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


@dataclass(frozen=True)
class Pace:
    """How patiently a region is untangled: at most so many ``steps``, the ``first`` regularisation, and by which part
    it falls at the ``slowest``."""

    steps: int
    first: float = 0.5
    slowest: float = 0.4


@dataclass
class Untangler:
    """Moves the unknowns of a region from coordinates ``x`` (n, 3), until it is ``late``."""

    region: Region
    x: FloatArray
    steps: int = 0
    progress: Callable[[str, int, int], None] | None = None
    late: Callable[[], bool] = lambda: False

    def __post_init__(self) -> None:
        self._system = NewtonSystem(self.region)

    def state(self, x: FloatArray, penalty: Penalty) -> State:
        n = len(self.region.energy.nodes)
        parts = np.empty((-(-n // _ELEMENTS), 3))

        def work(low: int, high: int) -> None:
            parts[low // _ELEMENTS] = self.region.energy.sum(x, penalty, low, high)

        for_chunks(work, n, _ELEMENTS)
        return State(x, parts[:, 0].sum(), parts[:, 1].min(), parts[:, 2].max())

    def untangle(self, pace: Pace) -> bool:
        """Newton steps until every determinant is positive.

        The regularisation falls as in Garanzha et al. 2021 (section 2.3), but by at least ``pace.slowest`` where the
        energy hardly changes any more: a few extra steps at the end cost less than many on the way.
        """
        eps = pace.first
        for step in range(pace.steps + 1):
            now = self.state(self.x, Penalty(eps))
            if now.lowest > 0.0:
                return True
            if step == pace.steps or now.lowest < -_LOCKED * eps or self.late():
                break
            self._tell(step, pace.steps)
            after = self._step(now, Penalty(eps))
            self.x = after.x
            eps = _next_eps(eps, after.lowest, max(pace.slowest, 1.0 - after.energy / now.energy))
        return False

    def improve(self, most: int) -> float:
        """Newton steps that lower the largest density from a valid start, while they help; returns it.

        The barrier approaches the largest density as the energy converges, but always by some part of the distance.
        Guarded elements keep a barrier of their own.
        """
        first = best = now = self.state(self.x, Penalty(0.0))
        for _ in range(_SETTLING if self.steps else 0):
            # What the regularisation has moved without need returns, before guarded elements are compared with it.
            now = self._step(now, Penalty(0.0))
        self.region.energy.guard(now.x, GUARDED)
        best = min(best, now, key=lambda state: state.highest)
        t, recent = 0.5 / now.highest, [np.inf] * _WINDOW
        for step in range(most):
            if self.late() or now.highest < _GOOD or best.highest > _STALLED * recent[-_WINDOW]:
                break
            self._tell(step, most)
            recent.append(best.highest)
            before = self.state(now.x, Penalty(0.0, t))
            now = self._step(before, Penalty(0.0, t))
            best = min(best, now, key=lambda state: state.highest)
            t += max(_CLOSER, 1.0 - now.energy / before.energy) * (1.0 - t * now.highest) / now.highest
        self.x = (best if best is first else self._straightened(best)).x
        return best.highest

    def _straightened(self, now: State) -> State:
        """The state after a few steps that improve the worst shapes without spoiling what has been improved.

        The largest densities are often those of cells that have lost volume; skew ones may be below them.
        """
        if now.highest < _GOOD:
            return now
        energy = self.region.energy
        energy.guard(now.x, FIRM)
        t = 1.0 / (2.0 + (1.0 + _LOOSE) * (now.highest - 2.0))
        best, value, idle, smallest = now, float(energy.shapes(now.x).min()), 0, now.lowest
        for _ in range(_SHAPING):
            shapes, (lowest, density) = energy.shapes(now.x), energy.measure(now.x)
            energy.press((shapes < _WEAKEST * shapes.min()) | (lowest < _WEAKEST * smallest), density)
            now = self._step(self.state(now.x, Penalty(0.0, t)), Penalty(0.0, t))
            worst = float(energy.shapes(now.x).min())
            idle += 1
            if worst > _HELPS * value and now.lowest > _KEPT * smallest:
                best, value, idle = now, worst, 0
            if idle == _IDLE or self.late():
                break
        return best

    def _tell(self, done: int, most: int) -> None:
        if self.progress:
            self.progress("repair", done, most)

    def _step(self, now: State, penalty: Penalty) -> State:
        system = self._system
        system.fill(now.x, penalty)
        step, _ = system.direction(_TOLERANCE, _MOST_ITERATIONS)
        slope = float(np.vdot(step, system.gradient))
        self.steps += 1
        length = 1.0
        while length > _SMALLEST_STEP:
            after = self.state(self.region.moved(now.x, step, length), penalty)
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
