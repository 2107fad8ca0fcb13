"""Searches of a repair, in one process, by Newton's method: first until no sample is inverted, then for the minimum of
the energy."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..grid import FloatArray
from ..parallel import for_chunks
from .energy import Penalty, share_of
from .newton import scalar_product
from .options import Effort, Limit
from .region import Plot
from .tuned import CUBIC, POLISHED, SOFTENED

# Energies are summed over this many cells at a time.
_CELLS = 4096
# Measured work of evaluating the energy, relative to that of its derivatives.
_EVALUATION = 0.15
_ROUGH, _ROUGH_ITERATIONS = 3e-2, 200
_FINE, _FINE_ITERATIONS = 1e-5, 5000
# No step is begun after whose derivatives the limit allows fewer iterations of the linear solver than these.
_WORTHWHILE = 10
# A determinant that stays below -_LOCKED eps while eps falls cannot become positive in this region.
_LOCKED = 100.0
CLOSE = 1e-6
"""The minimum is reached when a step moves no node by more than this fraction of its shortest edge, or the next step is
estimated not to."""
# The tolerance of a linear system relative to the step before: a step removes about that share of the distance.
_FORCING = 0.05
# Largest ratio of the next step to its estimate; up to 6 was measured.
_SAFETY = 10.0
# The search ends where nothing changes by this part in so many steps.
_GAIN, _PATIENCE = 0.01, 5
_SMALLEST_STEP = 1e-4
# Parts of the indefinite second derivatives that are left out.
_DAMPING = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)
# Sufficient decrease in the line search (Armijo), and the round-off of the energy that it tolerates.
_DECREASE, _ROUND_OFF = 1e-4, 1e-13

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class State:
    """Coordinates, with the energy, the smallest determinant and the largest f there."""

    x: FloatArray
    energy: float
    lowest: float
    highest: float


@dataclass(frozen=True)
class Way:
    """A strategy of untangling a region: the largest number of ``steps``, the ``first`` regularisation and the
    ``slowest`` decrease of its effect in a step. ``patient``: all nodes move, with the full share of the energy.
    ``even``: cells at walls have little more weight than others, for grids that are untangled but have cells worse
    than allowed."""

    steps: int
    first: float
    slowest: float
    patient: bool = False
    even: bool = False


# A regularisation that starts large and falls slowly finds valid grids where a fast one fails.
QUICK, PATIENT = Way(60, 2.0, 0.35), Way(200, 50.0, 0.1, patient=True)
EVEN = replace(QUICK, patient=True, even=True)
_CONVERGING = 60
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6

WAYS: dict[Effort, tuple[Way, ...]] = {
    "hasty": (QUICK,),
    "quick": (QUICK, EVEN),
    "patient": (PATIENT, EVEN),
    "all": (QUICK, EVEN, PATIENT),
}
"""The strategies that are tried in turn."""


@dataclass(frozen=True)
class Search:
    """Result of a search: the ``shift`` (k, 3) of the nodes that a plot moves, whether it is that to the minimum, and
    whether no sample is inverted; the shift where that was so first, if the minimum was not reached; and the share."""

    shift: FloatArray
    converged: bool
    sound: bool
    steps: int
    untangled: FloatArray | None
    share: float


def smaller_regularisation(eps: float, lowest: float, change: float) -> float:
    """The regularisation with which chi of the ``lowest`` determinant is ``1 - change`` times what it is with ``eps``;
    0 where chi is less without any."""
    root = np.sqrt(eps * eps + lowest * lowest)
    chi = 0.5 * (lowest + root) if lowest > 0 else 0.5 * eps * eps / (root - lowest)
    goal = (1.0 - change) * chi
    return 2.0 * float(np.sqrt(goal * (goal - lowest))) if lowest < goal else 0.0


class Untangler:
    """Moves the unknowns of a plot from coordinates ``x`` (n, d), within a limit.

    ``reference`` (n, d) are the coordinates of zero elastic energy, from which no node moves more than ``farthest``.
    ``most``: the largest number of Newton steps, ``steps`` that of those taken. ``damping``: which part of _DAMPING of
    the indefinite second derivatives the next step leaves out first, ``damped`` that which the last one left out.
    """

    def __init__(
        self,
        plot: Plot,
        reference: FloatArray,
        farthest: float = np.inf,
        limit: Limit | None = None,
        progress: Progress | None = None,
    ):
        self.plot, self.region, self.system = plot, plot.region, plot.system
        self.x, self.reference, self.farthest = reference, reference, farthest
        self.limit, self.progress = limit or Limit(), progress or (lambda *_: None)
        self.most, self.steps = max(_FEWEST, _WORK // self.region.n_unknowns), 0
        self.damping, self.damped = 0, 1.0

    def state(self, x: FloatArray, penalty: Penalty) -> State:
        energy, size = self.region.energy, len(self.region.energy.nodes)
        parts = np.empty((-(-size // _CELLS), 3))

        def work(low: int, high: int) -> None:
            parts[low // _CELLS] = energy.sum(x, self.reference, penalty, low, high)

        for_chunks(work, size, _CELLS)
        self.limit.spend(_EVALUATION * self.region.energy.work)
        energies, lowest, highest = parts.T
        return State(x, float(energies.sum()), float(lowest.min(initial=np.inf)), float(highest.max(initial=0.0)))

    def untangle(self, way: Way) -> float | None:
        """Newton steps until every determinant is positive: the regularisation of the last of them, 0 if none was
        needed, or ``None`` if this failed.

        Cells at walls have smaller weights than in the energy to be minimised, as folds open sooner if all cells take
        part. The regularisation falls as in Garanzha et al. 2021 (section 2.3), but faster when the energy stalls.
        """
        whole, self.region = self.region, replace(self.region, energy=self.region.energy.softened(SOFTENED))
        eps, last, untangled = way.first, 0.0, False
        for step in range(way.steps + 1):
            now = self.state(self.x, Penalty(eps))
            untangled = now.lowest > 0.0
            if untangled or step == way.steps or now.lowest < -_LOCKED * eps or self.limit.reached:
                break
            self.progress("repair", step, way.steps)
            after, part = self._step(now, Penalty(eps), _ROUGH)
            self.x, last = after.x, eps
            change = max(way.slowest * (part or 1.0), 1.0 - after.energy / now.energy)
            eps = smaller_regularisation(eps, after.lowest, change)
        self.region = whole
        return last if untangled else None

    def minimise(self, share: float, most: int, eps: float = 0.0) -> bool:
        """At most ``most`` Newton steps to the minimum from a valid start; returns whether it was reached. The
        regularisation ``eps`` falls, to 0 once it raises the smallest determinant by no more than half."""
        penalty, whole = Penalty(eps, share, CUBIC, 1.0), self.region.energy.work + _WORTHWHILE * self.system.work
        now, earlier = self.state(self.x, penalty), deque[State](maxlen=_PATIENCE + 1)
        length, expected, order = np.inf, np.inf, 1 if self.region.slides else 2
        for step in range(most):
            earlier.append(now)
            if self.limit.reached or not self.limit.affords(whole):
                break
            if len(earlier) > _PATIENCE:
                # Whether the worst cells, the energy or, relative to their edges, the nodes have changed noticeably.
                old = earlier[0]
                pairs = (old.lowest, now.lowest), (old.highest - 2.0, now.highest - 2.0), (old.energy, now.energy)
                gained = any(abs(new - then) > _GAIN * abs(then) for then, new in pairs)
                if not gained and not self._relative(now.x - old.x) > _GAIN:
                    break
            self.progress("repair", step, most)
            # What is left after the last step need not be much less than CLOSE.
            enough = CLOSE / (_SAFETY**2 * expected) if expected else _ROUGH
            tolerance = min(_ROUGH, max(_FINE, _FORCING * length, enough))
            after, part = self._step(now, penalty, tolerance)
            before, length = length, self._relative(after.x - now.x)
            now = after
            self.x = now.x
            if penalty.eps > 0.0:
                eps = smaller_regularisation(penalty.eps, now.lowest, QUICK.slowest * (part or 1.0))
                penalty = penalty._replace(eps=eps)
                now, length = self.state(now.x, penalty), np.inf
                earlier.clear()
                continue
            # The next step is estimated from the linear solver's tolerance and Newton's convergence: quadratic, but
            # linear where nodes slide on curved surfaces, whose curvature the second derivatives leave out.
            expected = max(tolerance, (length / before) ** order) * length if before else np.inf
            # A step that was shortened, or not solved for, says nothing about the distance from the minimum, and where
            # the second derivatives are indefinite there is none.
            full = self.system.solved and self.damped == 0.0 and part >= 1.0
            if full and (length < CLOSE or (step and _SAFETY * expected < CLOSE)):
                return True
            if part == 0.0:
                break
        return False

    def _relative(self, change: FloatArray) -> float:
        """The largest change of a node (n, d), relative to its shortest undeformed edge."""
        return float((np.abs(change).max(axis=1) / self.plot.edges).max(initial=0.0))

    def _step(self, now: State, penalty: Penalty, tolerance: float) -> tuple[State, float]:
        """One step, and how much of it was taken, 0 if nothing lowers the energy."""
        step = self._newton(now, penalty, tolerance)
        slope = scalar_product(self.system.gradient, step)
        self.steps += 1
        length, after = 1.0, self._moved(now, penalty, step, 1.0)
        # The energy of an inverted element is not a number, which no comparison is true for.
        while not after.energy <= now.energy + _DECREASE * length * slope + _ROUND_OFF * abs(now.energy):
            length /= 2
            if length <= _SMALLEST_STEP:
                return now, 0.0
            after = self._moved(now, penalty, step, length)
        return after, length

    def _moved(self, now: State, penalty: Penalty, step: FloatArray, length: float) -> State:
        x = self.region.moved(now.x, self.system.unknowns, step, length)
        if self.farthest < np.inf:
            change = x - self.reference
            distance = np.sqrt((change**2).sum(axis=1))
            far = distance > self.farthest
            x[far] = self.reference[far] + change[far] * (self.farthest / distance[far])[:, None]
        return self.state(x, penalty)

    def _newton(self, now: State, penalty: Penalty, tolerance: float) -> FloatArray:
        """The step with as much of the indefinite second derivatives as leaves the whole positive definite.

        Without them the search creeps along flat valleys and past saddle points. The part left out rises until the step
        succeeds, and falls after steps that succeed at once. All are left out where half is too much, in the step after
        that, as computing them costs most of a step, or if eps is not 0.
        """
        last, system = len(_DAMPING) - 1, self.system
        first = self.damping if penalty.eps == 0.0 else last
        for number in range(first, last + 1):
            self.damped = _DAMPING[number]
            self.limit.spend(self.region.energy.work)
            if system.fill(self.region, now.x, self.reference, penalty._replace(exact=1.0 - self.damped)):
                most = _ROUGH_ITERATIONS if number == last else _FINE_ITERATIONS
                step, convex = system.direction(tolerance, min(most, max(1, self.limit.affords(system.work))))
                self.limit.spend(system.work * system.iterations)
                if convex:
                    break
        if penalty.eps == 0.0:
            self.damping = max(number - 1, 0) if number == first else number
        return step

    def search(self, way: Way, polish: bool) -> Search | None:
        """The minimum of the energy; ``None`` if no cell is weak.

        ``polish``: the energy always has its full share, and cells at walls have little more weight than others.
        """
        share, energy, *_ = share_of(self.region.energy, self.reference)
        raised = max(share, 1.0 if polish or way.patient else 0.0)
        if raised == 0.0:
            return None
        self.region = replace(self.region, energy=energy.softened(POLISHED) if polish or way.even else energy)
        eps, first = self.untangle(replace(way, steps=min(way.steps, self.most))), self.x
        untangled = eps is not None
        converged = eps is not None and self.minimise(raised, min(_CONVERGING, self.most), eps)
        moved = self.plot.shift(self.x - self.reference)
        kept = self.plot.shift(first - self.reference) if untangled and not converged else None
        return Search(moved, converged and (polish or raised == share), untangled, self.steps, kept, share)
