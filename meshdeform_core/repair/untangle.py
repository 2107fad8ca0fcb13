"""Newton's method for the energy of a region: first until no sample is inverted, then to its minimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..grid import FloatArray
from ..parallel import for_chunks
from .newton import NewtonSystem
from .region import Penalty, Region

_ELEMENTS = 4096
_ROUGH, _ROUGH_ITERATIONS = 3e-2, 200
_FINE, _FINE_ITERATIONS = 1e-5, 5000
SOFTENED = 0.5
"""Power of the weights of cells while they are untangled."""
CUBIC = 2.0
"""Of the energy that is minimised: the larger, the more the worst cells count."""
# A determinant that stays below -_LOCKED eps while eps falls has nowhere to go in this region.
_LOCKED = 100.0
CLOSE = 1e-6
"""The minimum is reached when a step moves no node by more than this share of its shortest edge."""
_SMALLEST_STEP = 1e-4
# Sufficient decrease of a line search (Armijo), but for round-off of the energy.
_DECREASE, _ROUND_OFF = 1e-4, 1e-13


@dataclass(frozen=True)
class State:
    """Coordinates with the energy there, its smallest determinant and its largest f."""

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
    """Moves the unknowns of a region from coordinates ``x`` (n, d), until it is ``late``.

    ``reference`` (n, d) is where the elastic energy holds them.
    """

    region: Region
    x: FloatArray
    reference: FloatArray
    system: NewtonSystem
    steps: int = 0
    progress: Callable[[str, int, int], None] | None = None
    late: Callable[[], bool] = lambda: False

    def state(self, x: FloatArray, penalty: Penalty) -> State:
        n = len(self.region.energy.nodes)
        parts = np.empty((-(-n // _ELEMENTS), 3))

        def work(low: int, high: int) -> None:
            parts[low // _ELEMENTS] = self.region.energy.sum(x, self.reference, penalty, low, high)

        for_chunks(work, n, _ELEMENTS)
        return State(x, parts[:, 0].sum(), parts[:, 1].min(), parts[:, 2].max())

    def untangle(self, pace: Pace) -> bool:
        """Newton steps until every determinant is positive.

        Cells at walls weigh less here than in the energy to be minimised: a fold opens sooner where all take part.

        The regularisation falls as in Garanzha et al. 2021 (section 2.3), but by at least ``pace.slowest`` where the
        energy hardly changes any more: a few extra steps at the end cost less than many on the way.
        """
        region, eps = self.region, pace.first
        self.region = replace(region, energy=region.energy.softened(SOFTENED))
        untangled = self._untangle(pace, eps)
        self.region = region
        return untangled

    def _untangle(self, pace: Pace, eps: float) -> bool:
        for step in range(pace.steps + 1):
            now = self.state(self.x, Penalty(eps))
            if now.lowest > 0.0:
                return True
            if step == pace.steps or now.lowest < -_LOCKED * eps or self.late():
                break
            self._tell(step, pace.steps)
            after = self._step(now, Penalty(eps), _ROUGH)
            self.x = after.x
            eps = _next_eps(eps, after.lowest, max(pace.slowest, 1.0 - after.energy / now.energy))
        return False

    def minimise(self, share: float, most: int, edges: FloatArray) -> bool:
        """At most so many Newton steps to the minimum from a valid start; whether it was reached.

        ``edges`` (n,) are the shortest undeformed edges at the nodes.
        """
        penalty = Penalty(0.0, share, CUBIC, 1.0)
        now, length = self.state(self.x, penalty), np.inf
        for step in range(most):
            if self.late():
                break
            self._tell(step, most)
            after = self._step(now, penalty, min(_ROUGH, max(_FINE, 0.1 * length)))
            length = float((np.abs(after.x - now.x).max(axis=1) / edges).max())
            now = after
            self.x = now.x
            if length < CLOSE:
                return True
        return False

    def _tell(self, done: int, most: int) -> None:
        if self.progress:
            self.progress("repair", done, most)

    def _step(self, now: State, penalty: Penalty, tolerance: float) -> State:
        """A step with the complete second derivatives where they are positive definite, and eps is 0."""
        step = self._exact(now, penalty, tolerance) if penalty.eps == 0.0 else None
        if step is None:
            self.system.fill(self.region, now.x, self.reference, penalty)
            step, _ = self.system.direction(tolerance, _ROUGH_ITERATIONS)
        slope = float(np.vdot(step, self.system.gradient))
        self.steps += 1
        length = 1.0
        while length > _SMALLEST_STEP:
            after = self.state(self.region.moved(now.x, self.system.unknowns, step, length), penalty)
            if after.energy <= now.energy + _DECREASE * length * slope + _ROUND_OFF * abs(now.energy):
                return after
            length /= 2
        return now

    def _exact(self, now: State, penalty: Penalty, tolerance: float) -> FloatArray | None:
        if not self.system.fill(self.region, now.x, self.reference, penalty._replace(exact=True)):
            return None
        step, convex = self.system.direction(tolerance, _FINE_ITERATIONS)
        return step if convex else None


def _next_eps(eps: float, lowest: float, change: float) -> float:
    """The regularisation with which chi of the smallest determinant is ``1 - change`` times what it is now."""
    root = np.sqrt(eps * eps + lowest * lowest)
    chi = 0.5 * (lowest + root) if lowest > 0 else 0.5 * eps * eps / (root - lowest)
    goal = (1.0 - change) * chi
    return 2.0 * float(np.sqrt(goal * (goal - lowest))) if lowest < goal else 1e-10
