"""The runs behind each table of the paper: sample, size, method, and what a run costs and gives; keys link them to
``paper.toml``."""

from __future__ import annotations

import dataclasses
import functools
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from meshdeform_core.deform import Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import IDW, RBF, TFI, Account, Options, make_method
from meshdeform_core.methods.scattered.rbf import Basis
from meshdeform_core.quality import Assessment, assess
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import case_of

from .. import case_content, load
from .paper_methods import MinresRBF, ReweightedIDW, count_operations

# As in the paper, costs and operations are those of exact sums and a direct solver.
# Eqs. 14-28 as printed: the exponents of Luke et al., every node with its own rotation, shares by weight.
_PRINTED: dict[str, Any] = {"a": 3.0, "smoothing": 0, "transition": 0}
_EXACT: dict[str, Any] = {"summation": "exact", **_PRINTED}
_DIRECT: dict[str, Any] = {"solver": "direct", "summation": "exact"}
_PAPER_IDW: dict[str, Any] = {"rotation": "quaternion", "alpha": 0.1, **_EXACT}
_WHOLE = TFI(max_cells=0)
_BASES: dict[str, Basis] = {
    "wc0": "wendland-c0", "wc2": "wendland-c2", "c1": "ctps-c1", "c2a": "ctps-c2a", "c2b": "ctps-c2b",
}  # fmt: skip
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


@functools.lru_cache(maxsize=2)
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


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper: its runs, and the row whose cost is 1."""

    name: str
    trials: tuple[Trial, ...]
    reference: str


def _trials(sample: Sample, methods: dict[str, Options]) -> tuple[Trial, ...]:
    return tuple(Trial(key, sample, method) for key, method in methods.items())


def _idw(**options: Any) -> Options:
    return Options("idw", idw=IDW(**{**_EXACT, **options}))


def _division(divisions: int) -> Options:
    """The paper's division, which finds new weights in every step."""
    return Options("idw", idw=ReweightedIDW(**_EXACT, rotation="division", divisions=divisions))


def _rbf(**options: Any) -> Options:
    return Options("rbf", rbf=RBF(**options, **_DIRECT))


def _greedy(basis: Basis, radius: float, **more: Any) -> Options:
    """The paper's hybrid greedy reduction: absolute errors, eps_g = 1e-2, no correction of the remaining error."""
    chosen: dict[str, Any] = {"greedy_error": "absolute", "greedy_tolerance": 1e-2, "greedy_correct": False}
    return _rbf(basis=basis, radius=radius, greedy="hybrid", **(chosen | more))


def table2(quick: bool) -> PaperTable:
    """Problem 1: a square whose four sides move."""
    square = Sample("square", 61 if quick else 301)
    iterations, many = (2000, 50) if quick else (40_000, 500)
    methods = {"tfi": Options("tfi")}
    for key in ("wc0", "wc2", "c1", "tps"):
        basis: dict[str, Any] = {"basis": "tps"} if key == "tps" else {"basis": _BASES[key], "radius": 1.5}
        minres = MinresRBF(tolerance=1e-12, max_iterations=iterations, summation="exact", **basis)
        methods |= {key: Options("rbf", rbf=minres), f"{key}-direct": _rbf(**basis)}
        if key != "tps":
            methods[f"{key}-greedy"] = _greedy(_BASES[key], 1.5)
    methods |= {
        "idw-none": _idw(rotation="none"),
        "idw-division-25": _division(25),
        "idw-division-500": _division(many),
        "idw-lie": _idw(remove_mean=False),
    }
    marching = Trial("idw-marching-25", square, Options("idw", idw=IDW(**_PAPER_IDW)), steps=25)
    coarse = Trial("tps-coarse", Sample("square", 21), _rbf())
    return PaperTable("table2", (*_trials(square, methods), marching, coarse), "tfi")


def table3(quick: bool) -> PaperTable:
    """Problem 2: an ellipse becomes an airfoil."""
    methods = {"tfi": Options("tfi")}
    for key, basis in _BASES.items():
        methods[key] = _rbf(basis=basis, radius=15.0)
        if key != "wc0":
            methods[f"{key}-greedy"] = _greedy(basis, 15.0)
    by_cell: dict[str, Any] = {"greedy_error": "first-cell", "greedy_tolerance": 0.1, "greedy_correct": True}
    methods |= {
        "c2b-first-cell": _greedy("ctps-c2b", 15.0, **by_cell),
        "tps": _rbf(),
        "idw-auto": _idw(rotation="quaternion", alpha="auto"),
        "idw-0.1": _idw(rotation="quaternion"),
        "idw-blend": _idw(rotation="blend"),
    }
    return PaperTable("table3", _trials(Sample("airfoil", 201 if quick else 401), methods), "idw-0.1")


def table4(quick: bool) -> PaperTable:
    """Section 4: the splitter plate by all six methods."""
    paper: dict[str, IDW | RBF | TFI] = {"idw": IDW(**_PAPER_IDW), "rbf": RBF(**_DIRECT), "tfi": _WHOLE}
    lie = IDW(remove_mean=False, **_EXACT)
    six = ("tfi-tfi", "rbf-rbf", "idw-idw", "rbf-tfi", "idw-rbf", "idw-tfi")
    methods = {name: Options.relevant(name, **paper) for name in six}
    methods |= {f"{name}-lie": Options.relevant(name, idw=lie, tfi=_WHOLE) for name in ("idw-idw", "idw-tfi")}
    plate = Sample("splitter-plate", 8 if quick else 16)
    return PaperTable("table4", _trials(plate, {**methods, "default": Options()}), "tfi-tfi")


def table5(quick: bool) -> PaperTable:
    """Section 5: the hemisphere in 99 blocks; RBF on the largest grid whose matrix is factorised in a minute."""
    size, parts, small = (24, 12, 12) if quick else (92, 44, 32)
    split = Sample("hemisphere", size, (("max_cells", parts),), time=2.5e-4)
    lie, quaternion = IDW(remove_mean=False, **_EXACT), IDW(**_PAPER_IDW)
    methods = {name: Options.relevant(name, idw=lie, tfi=_WHOLE) for name in ("tfi-tfi", "idw-tfi")}
    methods |= {
        # 5e11 pairs take ten minutes; the tolerance does not affect the digits printed.
        "idw-idw": Options("idw-idw", idw=IDW(remove_mean=False, summation="fast", a=3.0, transition=0)),
        "idw-tfi-quaternion": Options("idw-tfi", idw=quaternion, tfi=_WHOLE),
        "default": Options(),
    }
    less = Trial("rbf-rbf", Sample("hemisphere", small, time=2.5e-4), _rbf())
    return PaperTable("table5", (*_trials(split, methods), less), "idw-tfi")


def figure_b(quick: bool) -> PaperTable:
    """Appendix B: the beam with the coordinate origin at the centre and at the lower left corner; always quick."""
    shifted: dict[str, Any] = {"options": (("origin", (2.0, 1.0)),), "constants": (("center", 2.0),)}
    corner, paper = Sample("beam", 40, **shifted), Options("idw", idw=IDW(**_PAPER_IDW))
    fine = {"one-corner-fine": paper, "lie-corner-fine": _idw()}
    trials = (
        Trial("one-centre", Sample("beam", 40), paper),
        Trial("marching-corner", corner, paper, steps=25),
        *_trials(corner, {"one-corner": paper, "division-corner": _division(25), "lie-corner": _idw()}),
        *_trials(Sample("beam", 400, **shifted), fine),
    )
    return PaperTable("figB", trials, "one-centre")


TABLES: dict[str, Callable[[bool], PaperTable]] = {
    "table2": table2, "table3": table3, "table4": table4, "table5": table5, "figB": figure_b,
}  # fmt: skip
"""Tables by their names on the command line."""
