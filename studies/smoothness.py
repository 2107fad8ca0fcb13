"""How smoothly repaired grids move, whether they depend on the boundary alone, and what a level costs.

python studies/smoothness.py                            the table on stdout
python studies/smoothness.py --only nozzle              some of the motions
python studies/smoothness.py --write studies/RESULTS.md  put the table in its place on the page
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
from flows import SAMPLES, grids_folder, without_missing_flap
from tables import Row, run

from meshdeform_core import stepping
from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.deform import Case, Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.numerics.arrays import lengths
from meshdeform_core.repair import energy
from meshdeform_core.repair.outcome import unhealthy_cells
from meshdeform_core.repair.tuned import HEALTHY
from meshdeform_core.series import Level, Schedule, deform_series
from meshdeform_core.velocity import shortest_edges
from meshdeform_formats.case import read_case
from meshdeform_formats.grids import read_grid
from meshdeform_samples import load
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

_SINGLE_RUNS = 3


@dataclass(frozen=True)
class Course:
    """A motion at ``times``; levels with equal ``phase`` (a number for each time) have the same boundary. ``onset``: f
    of cells that are weak."""

    make: Callable[[], Setup]
    times: FloatArray
    phase: Callable[[FloatArray], FloatArray] | None = None
    onset: float = HEALTHY


def _moving(select: str, part: Displace | Rotate) -> BoundarySpec:
    return BoundarySpec("wall", (select,), Kind.MOVING, None, Motion((part,), {}))


def _displace(*parts: str) -> Displace:
    x, y, z = (expression(part, {"x", "y", "z", "t"}) for part in parts)
    return Displace((x, y, z))


def _turn(angle: str, *center: float) -> Rotate:
    x, y, z = (expression(float(c), ()) for c in center)
    return Rotate(expression(angle, {"t"}), (0.0, 0.0, 1.0), (x, y, z))


def plate() -> Setup:
    """The splitter plate of the sample, which turns by t degrees."""
    setup = prepare_sample(Sample("splitter-plate", SAMPLES["splitter-plate"]))
    bend = _displace("0", "where(x > 0.5, 0.2*sin(2*pi*(x-0.5)/5), 0)", "0")
    body = BoundarySpec("body", ("body",), Kind.MOVING, None, Motion((bend, _turn("t", 0, 0, 0)), {}))
    rest = BoundarySpec("outer", ("outer",), Kind.FIXED), BoundarySpec("span", ("span",), Kind.SLIP)
    return set_up(setup.grid, Case((body, *rest)))


def nozzle() -> Setup:
    """A plane channel with inclined lines, whose roof comes down to 3 % of its height and goes up again."""
    x, s = np.linspace(-3.0, 3.0, 81), np.linspace(0.0, 1.0, 25)
    y = np.tile(s, (x.size, 1))
    block = np.stack([x[:, None] + 0.5 * y, y, 0.0 * y], axis=-1)[:, :, None]
    lowered = _displace("0", "-0.97*sin(pi*t)**2*exp(-((x-0.5)/0.4)**2)", "0")
    roof, floor = _moving("*.jmax", lowered), BoundarySpec("floor", ("*.jmin",), Kind.FIXED)
    return set_up(Grid.from_blocks([block]), Case((roof, floor)))


def airfoil() -> Setup:
    """An O-grid of y+ 1 around an ellipse that pitches by 75 degrees about its quarter chord."""
    angle, layer = np.linspace(0.0, 2.0 * np.pi, 97), np.arange(57)
    angle[-1] = 0.0
    circle = (0.28 + 1e-6 * (1.3**layer - 1.0) / 0.3)[None, :] * np.exp(1j * angle)[:, None]
    place = circle + 0.28 * 0.22 / circle
    block = np.stack([place.real, place.imag, 0.0 * place.real], axis=-1)[:, :, None]
    return set_up(Grid.from_blocks([block]), Case((_moving("*.jmin", _turn("75*sin(2*pi*t)", -0.25, 0, 0)),)))


def hemisphere() -> Setup:
    """The hemisphere of the sample with three to six times its amplitude; nodes slide on the curved outer side."""
    grid = load("hemisphere").generate(SAMPLES["hemisphere"])
    size = "0.066*sin(2*pi*t)*z/0.075*cos(4*atan2(hypot(x, y), z))/0.075"
    skin = BoundarySpec(
        "membrane", ("membrane",), Kind.MOVING, None, Motion((_displace(*(f"{a}*{size}" for a in "xyz")),), {})
    )
    rest = BoundarySpec("plate", ("plate",), Kind.FIXED), BoundarySpec("outer", ("outer",), Kind.SLIP)
    return set_up(grid, Case((skin, *rest)))


def flap() -> Setup:
    """Turek and Hron's flap in FSI2: its tip moves by 0.08 m, and once by 0.14 m."""
    folder = grids_folder() / "turek"
    case = read_case(folder / "case.toml").case
    bent = Motion((_displace("0", "0.14*sin(2*pi*t)*((x-0.24899)/0.35101)**2", "0"),), {})
    specs = (dataclasses.replace(s, motion=bent) if s.kind is Kind.MOVING else s for s in case.boundaries)
    return set_up(read_grid(folder / "turek.p3d"), dataclasses.replace(case, boundaries=tuple(specs)))


def _stroke(t: FloatArray) -> FloatArray:
    """Times at which sin(pi t)^2 is the same."""
    return np.abs((t + 0.5) % 1.0 - 0.5)


COURSES: dict[str, Course] = {
    "splitter plate, 30 to 75 degrees by 1": Course(plate, np.arange(30.0, 75.5, 1.0)),
    "splitter plate, 44 to 46 degrees by 0.2": Course(plate, np.arange(44.0, 46.1, 0.2)),
    "splitter plate, 44 to 44.5 degrees by 0.05": Course(plate, np.arange(44.0, 44.51, 0.05)),
    "nozzle to 3 %, two periods": Course(nozzle, np.linspace(0.0, 2.0, 129), _stroke),
    "nozzle to 3 %, closing, a quarter of the interval": Course(nozzle, np.linspace(0.0, 0.5, 129)),
    **{
        f"nozzle to 3 %, closing, a quarter of the interval, onset f = {f:g}": Course(
            nozzle, np.linspace(0.0, 0.5, 129), onset=f
        )
        for f in (2.3, 2.75, 3.0)
    },
    "airfoil, y+ 1, pitching by 75 degrees": Course(
        airfoil, np.linspace(0.0, 1.0, 41), lambda t: np.round(np.sin(2.0 * np.pi * t), 9)
    ),
    "hemisphere, curved slip wall": Course(hemisphere, np.linspace(0.15, 0.35, 9), lambda t: np.abs(t - 0.25)),
    "flap of Turek and Hron, tip 0.14 m": Course(
        flap, np.linspace(0.0, 1.0, 41), lambda t: np.round(np.sin(2.0 * np.pi * t), 9)
    ),
    "flap of Turek and Hron, bending, a quarter of the interval": Course(flap, np.linspace(0.0, 0.25, 41)),
}


@contextmanager
def onset_at(f: float) -> Iterator[None]:
    """Repairs that set in at f, and have their full share where they have it by default."""
    full, between = np.log(15.0 / f), np.log(4.0 / f)
    with (
        patch.multiple(energy, HEALTHY=f, FULL=full, BETWEEN=between, ALONG=(between / full) ** energy.POWER),
        patch.object(unhealthy_cells, "__defaults__", (f,)),
        patch.object(stepping, "AS_PLANE", 2.0 + 0.6 * (f - 2.0)),
    ):
        yield


def measure(name: str, course: Course) -> Row:
    """One row: the levels of a motion, some of them made alone."""
    with onset_at(course.onset):
        return _measured(name, course)


def _measured(name: str, course: Course) -> Row:
    setup, times = course.make(), np.round(course.times, 12)
    edges, levels, seconds = shortest_edges(setup.grid), [], []
    begin = time.process_time()
    for level in deform_series(setup, Schedule(tuple(times)), "float64"):
        levels.append(level)
        seconds.append(time.process_time() - begin)
        begin = time.process_time()
    repaired = [n for n, level in enumerate(levels) if level.result.repair]
    sampled = repaired[:: max(1, len(repaired) // _SINGLE_RUNS)][: _SINGLE_RUNS + 1]
    alone = [impose(setup, setup.motion(times[n]), None, "float64", Timing()).grid.points for n in sampled]
    single = max(
        (apart(levels[n].result.grid.points, x, edges) for n, x in zip(sampled, alone, strict=True)), default=0
    )
    accelerations = _acceleration(setup, levels)
    return {
        "motion": name,
        "levels": len(levels),
        "repaired": len(repaired),
        "valid": sum(level.result.valid for level in levels),
        "at the minimum": sum(levels[n].result.repair.converged for n in repaired),
        "acceleration, wall steps": accelerations[0],
        "with half the interval": accelerations[1],
        "without a repair": _unrepaired(setup, times),
        "from single runs, edges": f"{single:.0e}",
        "same boundary, edges": returning(course, times, levels, edges),
        "off slip walls, edges": _off_walls(setup, levels, edges),
        "J min": min(level.result.assessment.after.min_relative_jacobian for level in levels),
        "CPU s of a repaired level": float(np.mean([seconds[n] for n in repaired[1:]] or [0.0])),
        "of one without": _plain_seconds(setup, times),
    }


def _acceleration(setup: Setup, levels: list[Level]) -> tuple[float, float]:
    """The largest node acceleration beyond that of the walls, in the largest step of the walls: that of the motion, and
    with half the interval around the level where it was found."""
    longest, beyond = accelerations(setup, levels)
    at = int(beyond.argmax())
    if beyond[at] <= 0.0:
        return 0.0, 0.0
    first, last = max(0, at - 2), min(at + 2, len(levels) - 1)
    times = np.linspace(levels[first].time, levels[last].time, 2 * (last - first) + 1)
    _, finer = accelerations(setup, list(deform_series(setup, Schedule(tuple(times)), "float64")))
    return float(beyond[at] / longest), float(finer.max() / (longest / 2.0))


def _unrepaired(setup: Setup, times: FloatArray) -> float:
    """The largest acceleration, as above, of the method's own grids: without a repair, in one step for every level."""
    levels = deform_series(setup.with_repair("off"), Schedule(tuple(times)), "float64")
    longest, beyond = accelerations(setup, list(levels))
    return float(beyond.max() / longest)


def accelerations(setup: Setup, levels: list[Level]) -> tuple[float, FloatArray]:
    """The largest step of the walls, and at every level the acceleration of nodes beyond that of the walls."""
    walls = setup.topology.first[setup.boundary.kind == Kind.MOVING]
    points = [level.result.grid.points for level in levels]
    steps = [float(lengths((b - a)[walls]).max()) for a, b in itertools.pairwise(points)]
    pairs = [max(pair) for pair in itertools.pairwise(steps)]
    found = [level.smoothness.beyond * largest for level, largest in zip(levels[2:], pairs, strict=True)]
    return max(steps), np.array([0.0, 0.0, *found])


def _off_walls(setup: Setup, levels: list[Level], edges: FloatArray) -> str:
    """The largest distance of nodes from the curved surfaces on which they slide."""
    worst = [0.0]
    for surface in setup.boundary.slip.curved:
        nodes = setup.topology.first[surface.nodes]
        worst += [(surface.closest(level.result.grid.points[nodes])[2] / edges[nodes]).max() for level in levels]
    return f"{max(worst):.0e}" if setup.boundary.slip.curved else ""


def apart(one: FloatArray, two: FloatArray, edges: FloatArray) -> float:
    return float((lengths(one - two) / edges).max())


def returning(course: Course, times: FloatArray, levels: list[Level], edges: FloatArray) -> str:
    """The largest distance of levels with the same boundary from the first of them."""
    if course.phase is None:
        return ""
    first: dict[float, FloatArray] = {}
    worst = 0.0
    for level, phase in zip(levels, np.round(course.phase(times), 9), strict=True):
        points = level.result.grid.points
        worst = max(worst, apart(first.setdefault(float(phase) + 0.0, points), points, edges))
    return f"{worst:.0e}"


def _plain_seconds(setup: Setup, times: FloatArray) -> float:
    """CPU time of a level of the same motion without repairs."""
    begin = 0.0
    for number, _ in enumerate(deform_series(setup.with_repair("off"), Schedule(tuple(times[:4])), "float64")):
        begin = time.process_time() if number == 0 else begin
    return (time.process_time() - begin) / 3.0


def main() -> None:
    """The command line."""
    run(lambda: without_missing_flap(COURSES), measure, __doc__, __file__)


if __name__ == "__main__":
    main()
