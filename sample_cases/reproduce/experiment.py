"""One row of a table: a sample, a method, cost and result."""

from __future__ import annotations

import dataclasses
import functools
import time as clock
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from meshdeform_core.deform import Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import Account, Options, make_method
from meshdeform_core.quality import Assessment, assess
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import case_of

from .. import case_content, load
from .operations import count_operations

_ENOUGH_SECONDS = 1.0
_REPEATS = 4


@dataclass(frozen=True)
class Sample:
    """A sample case at a size; ``options`` are further arguments of its generator, ``time`` is passed to its motion."""

    name: str
    size: int
    options: tuple[tuple[str, Any], ...] = ()
    time: float = 0.0
    constants: tuple[tuple[str, float], ...] = ()

    @property
    def label(self) -> str:
        extra = "".join(f", {key} = {value}" for key, value in (*self.options, *self.constants))
        return f"{self.name} {self.size}{extra}"


@dataclass(frozen=True)
class Trial:
    """A row: ``key`` joins it to the paper's values; ``steps`` > 1 marches."""

    key: str
    sample: Sample
    method: Options
    steps: int = 1


@dataclass(frozen=True)
class Outcome:
    """The result of a trial: the deformed nodes, their quality, the method's account, its costs.

    ``cpu`` and ``wall`` are seconds of set-up and deformation, ``cpu_apply`` CPU seconds of the deformation alone.
    """

    setup: Setup
    points: FloatArray
    assessment: Assessment
    account: Account
    cpu: float
    cpu_apply: float
    wall: float
    gflop: float | None


@lru_cache(maxsize=2)
def prepare_sample(sample: Sample) -> Setup:
    """Grid, topology and boundary of a sample; the last two are kept."""
    module = load(sample.name)
    grid = module.generate(sample.size, **dict(sample.options))
    content = case_content(sample.name, module.tables(sample.size) if hasattr(module, "tables") else {})
    content["constants"] = content.get("constants", {}) | dict(sample.constants)
    return set_up(grid, case_of(content).case)


def run(trial: Trial) -> Outcome:
    """Deform and judge. Short runs are repeated and the lowest cost taken, which excludes topology and quality."""
    setup = prepare_sample(trial.sample)
    case = dataclasses.replace(setup.case, method=trial.method, repair=RepairOptions("off"))
    setup = dataclasses.replace(setup, case=case)
    if trial.steps > 1:
        timing, start = Timing(), clock.process_time()
        result = impose(setup, setup.motion(trial.sample.time), trial.steps, setup.grid.precision, timing)
        wall = timing.seconds["prepare"] + timing.seconds["apply"]
        cpu = (clock.process_time() - start) * wall / sum(timing.seconds.values())
        return Outcome(setup, result.grid.points, result.assessment, result.account, cpu, cpu, wall, None)
    _compile(trial.method, setup.grid.dimension)
    problem, method = setup.problem, make_method(trial.method)
    displacement = setup.displacement(trial.sample.time)[problem.source_numbers]
    cpu = cpu_apply = wall = np.inf
    spent = 0.0
    for _ in range(_REPEATS):
        start, start_cpu = clock.perf_counter(), clock.process_time()
        prepared = method.prepare(problem)
        between = clock.process_time()
        moved = prepared.apply(displacement)
        end_cpu, seconds = clock.process_time(), clock.perf_counter() - start
        cpu, cpu_apply, wall = min(cpu, end_cpu - start_cpu), min(cpu_apply, end_cpu - between), min(wall, seconds)
        spent += seconds
        if spent > _ENOUGH_SECONDS:
            break
    points = setup.grid.points + moved
    assessment = assess(setup.original, points, setup.boundary)
    # Only exact sums have a formula: the cost of fast sums depends on the displacement.
    summation = prepared.account.settings.get("summation")
    counted = summation is None or summation.value == "exact"
    gflop = count_operations(method, problem, prepared.account) / 1e9 if counted else None
    return Outcome(setup, points, assessment, prepared.account, cpu, cpu_apply, wall, gflop)


@functools.cache
def _compile(options: Options, dimension: int) -> None:
    """Run a method on a small grid, so that no row includes the compilation of its loops."""
    setup = prepare_sample(Sample("square", 21) if dimension == 2 else Sample("splitter-plate", 8))
    idw = dataclasses.replace(options.idw, summation="fast") if options.idw.summation == "auto" else options.idw
    relevant = Options.relevant(options.name, idw=idw, rbf=options.rbf, tfi=options.tfi)
    prepared = make_method(relevant).prepare(setup.problem)
    prepared.apply(setup.displacement(0.0)[setup.problem.source_numbers])


def quality_without_walls(trial: Trial) -> float:
    """<f_skew> of a reduced RBF with boundary nodes where the interpolation puts them, with an error up to eps_g."""
    setup = prepare_sample(trial.sample)
    problem, points = setup.problem, setup.grid.points
    bound = trial.method.rbf.bind(problem, np.arange(len(points)))
    moved = np.empty_like(points)
    fit = bound.fit(setup.displacement(trial.sample.time)[problem.source_numbers])
    bound.evaluate(fit, moved)
    return assess(setup.original, points + moved, setup.boundary).after.f_skew.harmonic_mean


def asymmetry(outcome: Outcome, center: float) -> float:
    """Largest distance between a deformed node and the mirror image, at the plane x = ``center``, of its partner."""
    from scipy.spatial import cKDTree

    mirror, shift = np.array([-1.0, 1.0, 1.0]), np.array([2 * center, 0.0, 0.0])
    before = outcome.setup.grid.points
    _, partner = cKDTree(before).query(before * mirror + shift)
    gap = outcome.points - (outcome.points[partner] * mirror + shift)
    return float(np.linalg.norm(gap, axis=1).max())
