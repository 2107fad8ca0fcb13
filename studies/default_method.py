"""How far the default is from the best of the program's own methods: channels that close, flaps, bodies that turn.

python studies/default_method.py                        the table on stdout
python studies/default_method.py --only channel         some of the motions
python studies/default_method.py --write studies/RESULTS.md  put the table in its place on the page
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from flows import SAMPLES, grids_folder, without_missing_flap
from motions import displace
from robustness_table import Trial, possible
from tables import Row, run

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import Motion
from meshdeform_core.deform import BoundaryMotion, Case, Setup, Timing, impose, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Options
from meshdeform_core.quality import Quality
from meshdeform_formats.case import read_case
from meshdeform_formats.grids import read_grid
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

METHODS = ("idw-tfi", "tfi", "rbf", "idw")


def channel(ni: int = 121, nj: int = 41) -> Grid:
    """Three blocks of height 1 with a bump of .2 at the floor; cells cluster at floor and roof."""
    x, s = np.linspace(-3.0, 3.0, ni), np.linspace(-1.0, 1.0, nj)
    share = 0.5 * (1.0 + np.tanh(2.2 * s) / np.tanh(2.2))
    floor = 0.2 * np.exp(-((x / 0.5) ** 2))
    y = floor[:, None] + (1.0 - floor[:, None]) * share
    whole = np.stack([np.tile(x[:, None], (1, nj)), y, 0 * y], axis=-1)[:, :, None]
    third = ni // 3
    return Grid.from_blocks([whole[: third + 1], whole[third : 2 * third + 1], whole[2 * third :]])


def _lowered(left: float) -> Setup:
    roof = Motion((displace("0", f"-{0.8 * (1.0 - left)}*exp(-(x/0.8)**2)", "0"),), {})
    walls = BoundarySpec("roof", ("*.jmax",), Kind.MOVING, None, roof), BoundarySpec("floor", ("*.jmin",), Kind.FIXED)
    return set_up(channel(), Case(walls))


def _flap(tip: float) -> Setup:
    folder = grids_folder() / "turek"
    case = read_case(folder / "case.toml", overrides=(f"constants.tip={tip}",)).case
    return set_up(read_grid(folder / "turek.p3d"), case)


def _sample(name: str, **constants: float) -> Setup:
    return prepare_sample(Sample(name, SAMPLES[name], constants=tuple(constants.items())))


Prescribed = tuple[Setup, BoundaryMotion]


def _at_once(setup: Setup, time: float = 0.0) -> Prescribed:
    return setup, setup.motion(time)


def _of_table(trial: Trial) -> Prescribed:
    setup = trial.make()
    return setup, trial.motion(setup)


MOTIONS: dict[str, Callable[[], Prescribed]] = {
    **{f"channel, roof down to {c:.0%}": (lambda c=c: _at_once(_lowered(c))) for c in (0.3, 0.1, 0.03)},
    **{f"flap, tip by {tip:g}": (lambda tip=tip: _at_once(_flap(tip))) for tip in (0.08, 0.14)},
    "splitter-plate, 30 degrees": lambda: _at_once(_sample("splitter-plate", angle=30.0)),
    "valve, 35 degrees": lambda: _at_once(_sample("valve", opening=35.0), 0.1),
    **{name: (lambda t=t: _of_table(t)) for name, t in possible().items() if not t.crossing},
}


def measure(setup: Setup, motion: BoundaryMotion) -> Iterator[tuple[str, Quality]]:
    """Quality of one motion by every method, repaired where needed."""
    for method in METHODS:
        own = dataclasses.replace(setup, case=dataclasses.replace(setup.case, method=Options(method)))
        yield method, impose(own, motion, None, "float64", Timing()).assessment.after


def wall_angle(quality: Quality) -> float:
    """Deviation from the normal over moving and fixed walls, degrees rms."""
    both = [walls.wall_normal_deviation_deg.rms for walls in quality.walls.values() if walls]
    return float(np.sqrt(np.mean(np.square(both))))


def _cell(quality: Quality) -> str:
    if quality.invalid_cells:
        return f"{quality.invalid_cells} invalid"
    return f"{quality.min_scaled_jacobian:.3f} / {quality.f_skew.min:.3f} / {wall_angle(quality):.1f}"


def row(name: str, make: Callable[[], Prescribed]) -> Row:
    """One row: a motion by every method, and how near the default is to the best of them."""
    found = dict(measure(*make()))
    best = max(quality.min_scaled_jacobian for quality in found.values() if not quality.invalid_cells)
    # Cells at a singular line have none.
    share = found[METHODS[0]].min_scaled_jacobian / best if best else 1.0
    return {"motion": name, **{m: _cell(q) for m, q in found.items()}, "default of best": f"{share:.2f}"}


def main() -> None:
    """The command line."""
    run(lambda: without_missing_flap(MOTIONS), row, __doc__, __file__)


if __name__ == "__main__":
    main()
