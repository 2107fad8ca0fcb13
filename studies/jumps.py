"""A search for jumps: levels at which a moving grid is accelerated although its walls are not.

python studies/jumps.py                            the table on stdout
python studies/jumps.py --only backstep            some of the motions
python studies/jumps.py --write studies/RESULTS.md  put the table in its place on the page

Every motion goes to its end and back on the same way, in 40 intervals.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from flows import SAMPLES, grids_folder
from motions import SPAN
from smoothness import Course, accelerations, apart, returning
from tables import Row, run

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.deform import Case, Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray
from meshdeform_core.series import Level, Schedule, deform_series
from meshdeform_core.velocity import shortest_edges
from meshdeform_formats.grids import read_grid
from meshdeform_samples import load

_TIMES = np.linspace(0.0, 1.0, 41)
_STROKE = "sin(pi*t)"
_SINGLE_RUNS = 4
_ENDS = "*.imin *.imax"
_BUMP = "8.55*where(abs(x - 4) < 4, cos(pi*(x - 4)/8)**2, 0)"


def _displace(*parts: str) -> Displace:
    """By three formulas times the stroke."""
    x, y, z = (expression(f"{_STROKE}*({part})", {"x", "y", "z", "t"}) for part in parts)
    return Displace((x, y, z))


def _rotate(angle: str, axis: tuple[float, float, float], *center: float) -> Rotate:
    x, y, z = (expression(float(c), ()) for c in center)
    return Rotate(expression(f"{_STROKE}*({angle})", {"x", "y", "z", "t"}), axis, (x, y, z))


def _moving(select: str, *parts: Displace | Rotate) -> BoundarySpec:
    return BoundarySpec("wall", tuple(select.split()), Kind.MOVING, None, Motion(parts, {}))


def _other(kind: Kind, select: str) -> BoundarySpec:
    return BoundarySpec(kind.name.lower(), tuple(select.split()), kind)


def _sample(name: str, *specs: BoundarySpec) -> Callable[[], Setup]:
    return lambda: set_up(load(name).generate(SAMPLES[name]), Case(specs))


def _third_party(file: str, *specs: BoundarySpec) -> Callable[[], Setup]:
    return lambda: set_up(read_grid(grids_folder() / file), Case(specs))


_SPANWISE, _SYMMETRY = _other(Kind.SLIP, "*.k*"), _other(Kind.SYMMETRY, "Sym")
_FLOOR = _other(Kind.FIXED, "*.kmin block3.jmin[1:2,1:25]")
_OPEN = _other(Kind.SLIP, f"{_ENDS} block1.jmin block4.jmax")
_BEND = _displace("0", f"0.5*{SPAN}*(z/{SPAN})**2", "0")
_CHANNEL = _other(Kind.FIXED, "floor channel"), _other(Kind.SLIP, "sides")

MOTIONS: dict[str, Callable[[], Setup]] = {
    "square, sides bent": _sample(
        "square",
        _moving("bottom", _displace("0", "0.4*max(0, 1 - abs(x - 0.5)/0.45)", "0")),
        _moving("top", _displace("0", "0.3*sin(pi*x)", "0")),
        _moving("left right", _displace("0.15*sin(2*pi*y)", "0", "0")),
    ),
    "ellipse, pitching by 120 degrees": _sample(
        "airfoil", _moving("airfoil", _rotate("120", (0, 0, 1), 0.25, 0, 0)), _other(Kind.FIXED, "outer")
    ),
    "beam, bent": _sample("beam", _moving("beam", _displace("0", "3.4*x**2", "0")), _other(Kind.FIXED, "outer")),
    "cascade, turning by 80 degrees": _sample(
        "cascade",
        _moving("bar", _rotate("80", (0, 0, 1), 0, 0, 0)),
        _other(Kind.FIXED, "inlet outlet"),
        _other(Kind.PERIODIC, "lower upper"),
    ),
    "cascade, plunging to 7 % of the gap": _sample(
        "cascade", _moving("bar", _displace("0", "1.4", "0")), _other(Kind.FIXED, "inlet outlet lower upper")
    ),
    "valve, opening by 75 degrees": _sample("valve", _moving("flap", _rotate("75", (0, 0, 1), 0, 0, 0)), *_CHANNEL),
    "valve, closing to 4 % of the gap": _sample("valve", _moving("flap", _displace("0", "-0.24", "0")), *_CHANNEL),
    "wing, bent and twisted by 40 degrees": _sample(
        "wing",
        _moving("wing", _rotate("20*y", (0, 1, 0), 0.25, 0, 0), _displace("0", "0", "0.25*y**2")),
        _other(Kind.SYMMETRY, "symmetry"),
        _other(Kind.FIXED, "far"),
    ),
}
THIRD_PARTY: dict[str, tuple[str, tuple[BoundarySpec, ...]]] = {
    "airfoil with wake, pitching by 120 degrees": (
        "nak_a_141.cgns",
        (_moving("Klo_Seg*", _rotate("120", (0, 1, 0), 0.25, 0, 0)), _other(Kind.SLIP, _ENDS)),
    ),
    "airfoil with wake, plunging by 2 chords": (
        "nak_a_141.cgns",
        (_moving("Klo_Seg*", _displace("0", "0", "2")), _other(Kind.SLIP, _ENDS)),
    ),
    "ring, turning by 150 degrees": (
        "cylinder_ring_4blk.x",
        (_moving("*.jmax", _rotate("150", (0, 0, 1), 0, 0, 0)), _SPANWISE),
    ),
    "ring, closing to 8 % of the gap": (
        "cylinder_ring_4blk.x",
        (_moving("*.jmax", _displace("2.3", "0", "0")), _SPANWISE),
    ),
    "backward facing step, closing to 5 %": (
        "backstep5_4levdn.p3dbin",
        (_moving("*.kmax", _displace("0", "0", "-7.6 - 0.475*(1 + tanh(x - 2))")), _OPEN, _FLOOR),
    ),
    "backward facing step, bump": (
        "backstep5_4levdn.p3dbin",
        (_moving("block3.kmin block4.kmin", _displace("0", "0", _BUMP)), _OPEN),
    ),
    "swept wing, bent by half its span": ("717_wl_L2.cgns", (_moving("wall", _BEND), _SYMMETRY)),
    "swept wing, twisted by 60 degrees": (
        "717_wl_L2.cgns",
        (_moving("wall", _rotate(f"60*z/{SPAN}", (0, 0, 1), 2.5, 0, 0)), _SYMMETRY),
    ),
}


def motions() -> dict[str, Callable[[], Setup]]:
    """The motions possible here."""
    here = {name: job for name, job in THIRD_PARTY.items() if (grids_folder() / job[0]).is_file()}
    return MOTIONS | {name: _third_party(file, *specs) for name, (file, specs) in here.items()}


def measure(name: str, make: Callable[[], Setup]) -> Row:
    """One row: the levels of a motion, shorter intervals around the largest acceleration, and single runs."""
    setup = make()
    levels, edges = _levels(setup, _TIMES), shortest_edges(setup.grid)
    longest, beyond = accelerations(setup, levels)
    at = int(beyond.argmax())
    repaired = [n for n, level in enumerate(levels) if level.result.repair]
    sampled = repaired[:: max(1, len(repaired) // _SINGLE_RUNS)]
    course = Course(make, _TIMES, lambda t: np.minimum(t, 1.0 - t))
    return {
        "motion": name,
        "repaired levels": len(repaired),
        "at the minimum": sum(levels[n].result.repair.converged for n in repaired),
        "not valid": sum(not level.result.valid for level in levels),
        "told": sum(any(_tells(text) for text in level.result.warnings) for level in levels),
        "acceleration, wall steps": beyond[at] / longest,
        "edges": levels[at].smoothness.acceleration_in_edges or 0.0,
        "at level": at,
        "with 1/2 of the interval": _closer(setup, levels, at, 2) / longest * 2,
        "1/4": _closer(setup, levels, at, 4) / longest * 4,
        "back and forth, edges": returning(course, _TIMES, levels, edges),
        "single runs, edges": f"{max((_alone(setup, levels[n], edges) for n in sampled), default=0.0):.0e}",
        "J min": min(level.result.assessment.after.min_relative_jacobian for level in levels),
    }


def _levels(setup: Setup, times: FloatArray) -> list[Level]:
    return list(deform_series(setup, Schedule(tuple(np.round(times, 12))), "float64"))


def _closer(setup: Setup, levels: list[Level], at: int, parts: int) -> float:
    """The largest acceleration (length per square of the interval) around a level, with a part of the interval."""
    first, last = max(0, at - 2), min(at + 1, len(levels) - 1)
    times = np.linspace(levels[first].time, levels[last].time, parts * (last - first) + 1)
    return float(accelerations(setup, _levels(setup, times))[1].max())


def _alone(setup: Setup, level: Level, edges: FloatArray) -> float:
    """The distance of a level from the grid of a single run."""
    alone = impose(setup, setup.motion(level.time), None, "float64", Timing())
    return apart(level.result.grid.points, alone.grid.points, edges)


def _tells(text: str) -> bool:
    return "jumps" in text


def main() -> None:
    """The command line."""
    run(motions, measure, __doc__, __file__)


if __name__ == "__main__":
    main()
