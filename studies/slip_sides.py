"""Motions towards and away from plane slip sides: how normal displacements should fade out beside them.

python studies/slip_sides.py                         the table on stdout
python studies/slip_sides.py --write studies/RESULTS.md  put the table in its place on the page
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from unittest.mock import patch

import numpy as np
from flows import SAMPLES
from motions import displace
from tables import Row, run

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion
from meshdeform_core.deform import Case, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Options, constraints, make_method
from meshdeform_core.quality import assess
from meshdeform_samples import load

WIDTHS = (0.0, 0.3, 0.5, 1.0)
"""Lengths of the parabolic end at the walls."""
Job = tuple[str, Callable[[], Grid], tuple[BoundarySpec, ...]]
"""Method, grid and boundary."""


def clustered_box() -> Grid:
    """64 blocks above a wall y = 0, between slip sides z = 0 and 1 with thin cells beside them."""
    u = np.linspace(0.0, 1.0, 33)
    z = 0.5 * (1.0 + np.tanh(3.0 * (2.0 * u - 1.0)) / np.tanh(3.0))
    cuts = [slice(first, first + 9) for first in range(0, 32, 8)]
    lines = [(u[i], u[j], z[k]) for i in cuts for j in cuts for k in cuts]
    return Grid.from_blocks([np.stack(np.meshgrid(*each, indexing="ij"), axis=-1) for each in lines])


def _spec(select: str, kind: Kind, where: str = "", *motion: str) -> BoundarySpec:
    formula = expression(where, {"x", "y", "z"}) if where else None
    return BoundarySpec(kind.label, (select,), kind, formula, Motion((displace(*motion),), {}) if motion else None)


def _boxes(method: str, *motion: str) -> Job:
    sides = _spec("*.k*", Kind.SLIP, "abs(z - 0.5) > 0.4999")
    outer = _spec("*", Kind.FIXED, "y > 0.999 or abs(x - 0.5) > 0.4999")
    return method, clustered_box, (sides, outer, _spec("*.jmin", Kind.MOVING, "y < 0.001", *motion))


def _samples(method: str, name: str, patches: str, *motion: str) -> Job:
    """``patches``: the wall, the slip side, and what is fixed."""
    wall, side, fixed = patches.split()
    specs = _spec(wall, Kind.MOVING, "", *motion), _spec(side, Kind.SLIP), _spec(fixed, Kind.FIXED)
    return method, lambda: load(name).generate(SAMPLES[name]), specs


_HEMISPHERE = "hemisphere", "membrane plate outer"
_PLATE = "splitter-plate", "body span outer"
_RADIAL = "0.44*z*cos(4*atan2(hypot(x, y), z))"
_MOTIONS: dict[str, Callable[[str], Job]] = {
    "box, floor in waves of 0.1": lambda m: _boxes(m, "0.01*sin(5*y)", "0.1*sin(3*x)*cos(2*z)", "0"),
    "box, floor to the side by 0.2": lambda m: _boxes(m, "0", "0", "0.2*sin(pi*z)*sin(pi*x)"),
    "hemisphere, radial": lambda m: _samples(m, *_HEMISPHERE, *(f"{c}/0.075*{_RADIAL}" for c in "xyz")),
    "hemisphere, flattened by a half": lambda m: _samples(m, *_HEMISPHERE, "0", "0", "-0.5*z"),
    "hemisphere, taller by a half": lambda m: _samples(m, *_HEMISPHERE, "0", "0", "0.5*z"),
    "hemisphere, sheared": lambda m: _samples(m, *_HEMISPHERE, "0.5*z", "0", "0.1*z*x/0.075"),
    "plate, bent along the span": lambda m: _samples(
        m, *_PLATE, "0", "where(x > 0.5, (0.3 + 0.4*z)*sin(2*pi*(x - 0.5)/5), 0)", "0"
    ),
    "wing, bent by 0.4 of its span": lambda m: _samples(
        m, "wing", "wing symmetry far", "0", "-0.16*2*(y/2)**3", "0.4*2*(y/2)**2"
    ),
}


def motions() -> dict[str, Job]:
    """Of the sample grids, with slip sides where they have others."""
    return {f"{name}; {method}": make(method) for name, make in _MOTIONS.items() for method in ("idw-tfi", "rbf-tfi")}


def row(name: str, job: Job) -> Row:
    """Smallest relative Jacobian and wall deviation (degrees rms) in one step, without and with the mend."""
    method, make, specs = job
    setup = set_up(make(), Case(specs))
    told = setup.displacement(0.0)[setup.problem.source_numbers]

    def measured(changed: AbstractContextManager[object]) -> str:
        with changed:
            moved = make_method(Options(method)).prepare(setup.problem).apply(told)
        after = assess(setup.original, setup.grid.points + moved, setup.boundary).after
        if after.invalid_cells:
            return f"{after.invalid_cells} invalid"
        walls = after.wall_normal_deviation_deg
        return f"{after.min_relative_jacobian:.2f} / {walls.rms if walls else np.nan:.1f}"

    without = patch.object(constraints.BesideSlip, "apply", lambda self, out, progress: None)
    ends = {f"{width:g}": measured(patch.object(constraints, "WIDTH", width)) for width in WIDTHS}
    return {"motion": name, "not faded": measured(without), **ends}


if __name__ == "__main__":
    run(motions, row, __doc__, __file__)
