"""A motion imposed step by step, each step from the last grid."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .boundary import Kind
from .boundary.doubts import positions_as_displacements
from .boundary.prescribed import largest_displacement
from .errors import MethodError
from .grid import FloatArray
from .grid.precision import rounded
from .methods import Account, Options, PreparedMethod, Problem, Progress, make_method
from .notices import Notice, first_of_each_kind, kind_of
from .parallel import empty, for_rows
from .quality.comparison import Comparison
from .quality.validity import Verdict, judge
from .repair.repair import PATIENTLY, QUICKLY, Repair, Repairer, Way
from .repair.time_limit import TimeLimit
from .setup import BoundaryMotion, Setup, Start, Timing


@dataclass(frozen=True)
class Attempt:
    """One attempted step of the motion: method, with or without repair, and outcome.

    ``steps`` counts the steps up to and including this one; ``reached`` is the fraction of the motion at its end.
    """

    method: str
    steps: int
    repair: bool
    invalid_cells: int
    reached: float


@dataclass(frozen=True)
class Trial:
    """Coordinates (n_nodes, 3) of a step, the verdict on them, and their quality measures if already computed."""

    fraction: float
    points: FloatArray
    verdict: Verdict
    cells: Comparison | None = None


_FEWEST_UNITS = 100
"""A motion of fewer units in the last place of the coordinates is rounded visibly."""


class March:
    """The state of a motion: the grid reached, the method prepared on it, and what has happened so far."""

    def __init__(
        self,
        setup: Setup,
        motion: BoundaryMotion,
        precision: str,
        timing: Timing,
        progress: Progress | None,
        start: Start | None = None,
    ):
        self.setup, self.motion, self.precision = setup, motion, precision
        self.timing, self.progress = timing, progress
        self.limit = TimeLimit(setup.case.repair.time_limit)
        self.start = start or Start(setup.grid.points)
        self.warnings = list(setup.warnings)
        self.notices: dict[str, str] = {}
        self.attempts: list[Attempt] = []
        self.repairs: list[Repair] = []
        self._prepared: tuple[FloatArray, Options, PreparedMethod] | None = None
        if start and start.prepared:
            self._prepared = start.points, setup.case.method, start.prepared
        self.restart(setup.case.method)
        self._inspect_motion(alone=start is None)

    def restart(self, options: Options) -> None:
        """Start again from the initial grid of the motion, with another method."""
        self.options = options
        self.fraction, self.steps = 0.0, 0
        self.points = self.start.points
        # Exactly zero from the undeformed grid.
        first, undeformed = self.setup.topology.first, self.setup.grid.points
        self.begin: FloatArray = np.zeros((len(first), 3))
        if self.points is not undeformed:
            self.begin = self.points[first] - undeformed[first]
        self.moved = self.begin
        self.last: Trial | None = None
        self.failed: Trial | None = None
        self.first_bad: dict[int, int] = {}

    def _inspect_motion(self, alone: bool) -> None:
        self.total = self.motion(1.0)
        self.max_displacement = largest_displacement(self.total)
        # Tables of a sequence are read only when their time comes.
        self.warnings += first_of_each_kind(self.setup.boundary.tables.warnings(), map(kind_of, self.warnings))
        # In a series, a level may have no displacement.
        if alone and self.max_displacement == 0.0:
            self.warnings.append("nothing moves: the displacement is zero everywhere")
        elif alone:
            self.warnings += self._coarsely_rounded()
        moving = np.flatnonzero(self.setup.boundary.kind == Kind.MOVING)
        points = self.setup.grid.points[self.setup.topology.first[moving]]
        self.warnings += positions_as_displacements(points, self.total[moving])
        departure = self.setup.boundary.slip.departure(self.total)
        # A motion that returns to zero leaves round-off in all directions.
        if departure > 1e-6 * self.max_displacement and departure > self.setup.round_off:
            text = (
                f"the motion carries nodes out of a slip or symmetry plane by up to {departure:.3g}; "
                f"the plane follows there; its other nodes stay in it"
            )
            self.warnings.append(Notice(text, "motion out of a sliding plane"))

    def _coarsely_rounded(self) -> list[str]:
        """A warning if rounding coordinates to the precision of the output changes a visible part of the motion."""
        moving = self.setup.topology.first[self.total.any(axis=1)]
        farthest = float(np.abs(self.setup.grid.points[moving]).max())
        unit = float(np.spacing(np.dtype(self.precision).type(farthest)))
        if self.max_displacement >= _FEWEST_UNITS * unit:
            return []
        remedy = "a grid nearer to the origin"
        if self.precision == "float32":
            remedy = "--variant precision=float64, or " + remedy
        return [
            f"coordinates of {farthest:.3g} in {self.precision} are multiples of {unit:.2g}, to which the motion of at "
            f"most {self.max_displacement:.3g} is rounded; more accurate: {remedy}"
        ]

    @property
    def account(self) -> Account:
        """Settings and warnings of the method on the last grid."""
        return self._method().account if self.last is None else self._account

    @cached_property
    def repairer(self) -> Repairer:
        """Repairs cells relative to the undeformed grid."""
        setup = self.setup
        return Repairer(setup.original, setup.boundary, self.rounded, setup.memory, self.progress, self.limit)

    def warn_ahead(self, first: float) -> None:
        """Collect the warnings for a motion whose first increment is the fraction ``first``."""
        sources = self.setup.problem.source_numbers
        motion, step = ((self._prescribed(part) - self.moved)[sources] for part in (1.0, first))
        self.warnings += self._method().warnings_for(motion, step)

    def trial(self, fraction: float, ways: tuple[Way, ...] = QUICKLY) -> Trial:
        """Move from the current grid to ``fraction`` of the motion, and repair the result if the case asks for it."""
        return self.repaired(self.plain_trial(fraction), ways)

    def plain_trial(self, fraction: float) -> Trial:
        """The same without a repair."""
        return self._noted(self._judged(fraction, self._moved(fraction)), repaired=False)

    def repaired(self, trial: Trial, ways: tuple[Way, ...] = QUICKLY) -> Trial:
        """A plain trial from the current grid, repaired if the case asks for it."""
        fraction = trial.fraction
        mode = self.setup.case.repair.mode
        if mode == "off" or not (mode == "polish" or self.repairer.needed(trial.verdict, trial.cells)):
            return trial
        correction = self.start.correction() if self.start.correction else None
        if correction is not None:
            trial = self._judged(fraction, self._sum(trial.points, correction))
            if mode != "polish" and not self.repairer.needed(trial.verdict, trial.cells):
                # Another minimum nearby would only make nodes jump in time.
                self.repairs.append(Repair.carried(correction))
                return self._noted(trial, repaired=True)
        self._broken = trial
        return self._repaired(trial, ways, keep=correction is not None or not trial.verdict.valid)

    def patient_trial(self, fraction: float) -> Trial:
        """The same; where the repair fails, it is done once more with patience."""
        trial = self.trial(fraction)
        return trial if trial.verdict.valid or self.setup.case.repair.mode == "off" else self.insist(trial)

    def insist(self, trial: Trial) -> Trial:
        """Repair once more what the last ``trial`` repaired, with more patience; returns the better one."""
        if self.limit.reached:
            return trial
        other = self._repaired(self._broken, PATIENTLY)
        if len(self.repairs) > 1:
            one, two = self.repairs[-2:]
            self.repairs[-2:] = [dataclasses.replace(one + two, cells=one.cells)]
        return other if len(other.verdict.invalid) < len(trial.verdict.invalid) else trial

    def _repaired(self, trial: Trial, ways: tuple[Way, ...], keep: bool = True) -> Trial:
        polish = self.setup.case.repair.mode == "polish"
        with self.timing.stage("repair"):
            outcome = self.repairer.repair(trial.points, trial.verdict, polish, ways)
        if outcome.repair.newton_steps:
            trial = Trial(trial.fraction, outcome.points, outcome.verdict)
        if outcome.repair.newton_steps or keep:
            self.repairs.append(outcome.repair)
        return self._noted(trial, repaired=True)

    def accept(self, trial: Trial) -> None:
        """Continue from the grid of a trial."""
        self._account = self._method().account
        self.notices |= self._account.notices
        self.moved = self._prescribed(trial.fraction)
        self.points, self.fraction, self.steps, self.last = trial.points, trial.fraction, self.steps + 1, trial
        for cell in trial.verdict.invalid.tolist():
            self.first_bad.setdefault(cell, self.steps)

    def rounded(self, points: FloatArray) -> FloatArray:
        """Coordinates as they will be written."""
        return rounded(points, self.precision)

    def _moved(self, fraction: float) -> FloatArray:
        prepared = self._method()
        increment = (self._prescribed(fraction) - self.moved)[self.setup.problem.source_numbers]
        with self.timing.stage("apply"):
            moved = prepared.apply(increment, self.progress)

            def add(rows: slice) -> None:
                np.add(self.points[rows], moved[rows], out=moved[rows])
                # While they are in the cache: what is no number passes all tests of cells.
                if not np.isfinite(moved[rows].sum()):
                    self._require_finite(moved[rows], rows.start)

            for_rows(add, moved)
            return moved

    def _require_finite(self, points: FloatArray, first: int) -> None:
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if bad.size:
            raise MethodError(
                f"{self.options.name} moves {self.setup.grid.node_label(first + int(bad[0]))} to "
                f"{points[bad[0]].tolist()}; expected finite coordinates, from "
                f"options and a motion of the size of the grid"
            )

    def _judged(self, fraction: float, points: FloatArray) -> Trial:
        """At the end of the motion all quality measures are taken at once: usually this grid is the result."""
        original, final = self.setup.original, self.rounded(points)
        with self.timing.stage("quality"):
            if fraction < 1.0:
                return Trial(fraction, points, judge(original, final))
            cells = Comparison(original, final)
            return Trial(fraction, points, cells.verdict, cells)

    def _noted(self, trial: Trial, repaired: bool) -> Trial:
        invalid = int(np.count_nonzero(trial.verdict.failed))
        self.attempts.append(Attempt(self.options.name, self.steps + 1, repaired, invalid, trial.fraction))
        return trial

    @staticmethod
    def _sum(one: FloatArray, two: FloatArray) -> FloatArray:
        result: FloatArray = empty(one.shape)
        for_rows(lambda rows: np.add(one[rows], two[rows], out=result[rows]), result)
        return result

    def _prescribed(self, fraction: float) -> FloatArray:
        """Boundary displacement at a fraction: along the motion's path from the undeformed grid, else linear."""
        if fraction == 1.0:
            return self.total
        if not self.begin.any():
            return self.motion(fraction)
        return self.begin + fraction * (self.total - self.begin)

    def _problem(self) -> Problem:
        """The problem on the current grid; that of the undeformed one keeps what it has found of its surface."""
        if self.points is self.setup.grid.points:
            return self.setup.problem
        return dataclasses.replace(self.setup.problem, grid=self.setup.grid.moved(self.points))

    def _method(self) -> PreparedMethod:
        """The method prepared on the current grid; kept while trials start from the same grid."""
        if self._prepared is None or self._prepared[0] is not self.points or self._prepared[1] is not self.options:
            with self.timing.stage("prepare"):
                self._prepared = self.points, self.options, make_method(self.options).prepare(self._problem())
        return self._prepared[2]
