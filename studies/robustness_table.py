"""Large motions in one command: validity, quality, state of the wall cells, and cost.

python studies/robustness_table.py                            all rows, table on stdout
python studies/robustness_table.py --only plate               some of them
python studies/robustness_table.py --grids FOLDER             where third-party grids lie (default: MESHDEFORM_GRIDS)
python studies/robustness_table.py --write studies/RESULTS.md  put the table in its place on the page
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from flows import grids_folder
from motions import SPAN, displace, rotate
from tables import Row, run

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.deform import BoundaryMotion, Case, Result, Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_formats.grids import read_grid
from meshdeform_samples import load
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

THIN = 1000.0
"""Corners of undeformed cells with edges longer than this, relative to the shortest, are boundary-layer corners."""


@dataclass(frozen=True)
class Trial:
    """A set-up case at a time, its motion times ``scale``; what is asked for, ``valid`` or the two patches that cross.

    ``skew`` and ``jacobian`` are the smallest f_skew and relative Jacobian asked for.
    """

    label: str
    make: Callable[[], Setup]
    time: float = 0.0
    scale: float = 1.0
    skew: float = 0.0
    jacobian: float = 0.0
    crossing: tuple[str, ...] = ()
    file: str = ""

    def motion(self, setup: Setup) -> BoundaryMotion:
        """Displacement of the boundary with a fraction of the motion imposed."""
        return lambda fraction: self.scale * setup.displacement(self.time, fraction)

    @property
    def possible(self) -> bool:
        """Whether its grid is here."""
        return not self.file or (grids_folder() / self.file).is_file()

    @property
    def asked(self) -> str:
        if self.crossing:
            return "crossing of " + " and ".join(self.crossing)
        parts = [f"{name} {value:g}" for name, value in (("f_skew", self.skew), ("J", self.jacobian)) if value]
        return ", ".join(parts) or "valid"


def _sample(
    name: str, label: str, time: float = 0.0, constants: dict[str, float] | None = None, **asked: float
) -> Trial:
    size = load(name).SIZES["small"]
    make = partial(prepare_sample, Sample(name, size, constants=tuple((constants or {}).items())))
    return Trial(f"{name}, {label}", make, time, **asked)  # type: ignore[arg-type]


def _third_party(file: str, label: str, specs: list[BoundarySpec], jacobian: float, *crossing: str) -> Trial:
    def make() -> Setup:
        return set_up(read_grid(grids_folder() / file), Case(tuple(specs)))

    return Trial(f"{file}, {label}", make, jacobian=jacobian, crossing=crossing, file=file)


def _moving(select: str, *parts: Rotate | Displace, name: str = "wall") -> BoundarySpec:
    return BoundarySpec(name, tuple(select.split()), Kind.MOVING, None, Motion(parts, {}))


def _slip(select: str, kind: Kind = Kind.SLIP) -> BoundarySpec:
    return BoundarySpec("slip", tuple(select.split()), kind)


def _wing(label: str, *parts: Rotate | Displace) -> Trial:
    return _third_party("717_wl_L2.cgns", label, [_moving("wall", *parts), _slip("Sym", Kind.SYMMETRY)], 0.3)


def _ring(label: str, jacobian: float, part: Rotate | Displace) -> Trial:
    return _third_party("cylinder_ring_4blk.x", label, [_moving("*.jmax", part), _slip("*.k*")], jacobian)


def _collapsed(label: str, part: Rotate | Displace) -> Trial:
    """A cylinder whose grid has a singular line, moved as a whole."""

    def make() -> Setup:
        angle, radius, z = np.linspace(0, 2 * np.pi, 25), np.linspace(0, 1, 9), np.linspace(0, 2, 7)
        a, r, h = np.meshgrid(angle, radius, z, indexing="ij")
        block = np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)
        block[-1] = block[0]
        return set_up(Grid.from_blocks([block]), Case((_moving("*", part),)))

    return Trial(f"cylinder with a singular line, {label}", make, jacobian=0.9)


_BACKSTEP, _AIRFOIL = "backstep5_4levdn.p3dbin", "nak_a_141.cgns"
_ENDS, _STREAM = "*.imin *.imax", "block1.jmin block4.jmax"
_BUMP = displace("0", "0", "8.55*where(abs(x - 4) < 4, cos(pi*(x - 4)/8)**2, 0)")
_ROOF = displace("0", "0", "-7.6 - 0.475*(1 + tanh(x - 2))")
_DROP = displace("0", "0", "-9.5")


def _backstep(label: str, jacobian: float, select: str, part: Displace, *crossing: str) -> Trial:
    floor = BoundarySpec("floor", ("*.kmin", "block3.jmin[1:2,1:25]"), Kind.FIXED)
    specs = [_moving(select, part, name="roof" if "kmax" in select else "bump"), _slip(f"{_ENDS} {_STREAM}")]
    return _third_party(_BACKSTEP, label, [*specs, floor] if "kmax" in select else specs, jacobian, *crossing)


TRIALS: tuple[Trial, ...] = (
    *(
        _sample("splitter-plate", f"{a:g} degrees", constants={"angle": a}, skew=skew)
        for a, skew in ((45, 0.35), (60, 0.20), (75, 0.15), (90, 0.10), (105, 0), (120, 0))
    ),
    Trial(
        "splitter-plate, 150 degrees",
        _sample("splitter-plate", "", constants={"angle": 150}).make,
        crossing=("body", "outer"),
    ),
    *(
        _sample("valve", f"{a} degrees", 0.1, {"opening": a}, jacobian=0.05 * (a == 100))
        for a in (65, 80, 100)
    ),
    *(_sample("cascade", f"{a} degrees", constants={"angle": a}, skew=0.14 * (a == 90)) for a in (60, 75, 90)),
    *(
        _sample("hemisphere", f"amplitude {a}", 2.5e-4, {"amplitude": a}, skew=0.52 * (a == 0.066))
        for a in (0.055, 0.066)
    ),
    *(_sample("beam", f"times {s:g}", scale=s, skew=0.04 * (s == 3.8)) for s in (2.0, 3.0, 3.8)),
    _sample("square", "times 1.5", scale=1.5, skew=0.26),
    _sample("wing", "times 6", scale=6.0, skew=0.57),
    _third_party(
        _AIRFOIL, "pitch 150 degrees", [_moving("Klo_Seg*", rotate("150", (0, 1, 0), 0.25, 0, 0)), _slip(_ENDS)], 0.4
    ),
    _wing("pitch 90 degrees", rotate("90", (0, 0, 1), 2.5, 0, 0)),
    _wing("bend 8", displace("0", f"8*(z/{SPAN})**2", "0")),
    _wing("twist 90 degrees", rotate(f"90*z/{SPAN}", (0, 0, 1), 2.5, 0, 0)),
    _ring("turned 180 degrees", 0.3, rotate("180", (0, 0, 1), 0, 0, 0)),
    _ring("squeezed to 5 %", 0.02, displace("2.375", "0", "0")),
    _backstep("bump 8.55", 0.02, "block3.kmin block4.kmin", _BUMP),
    _backstep("roof down to 5 %", 0.02, "*.kmax", _ROOF),
    _backstep("roof through the floor", 0.0, "*.kmax", _DROP, "roof", "floor"),
    _collapsed("translated", displace("0.7", "-0.3", "0.2")),
    _collapsed("turned 70 degrees", rotate("70", (1, 2, 0.5), 3, 0, 0)),
)  # fmt: skip
"""In the order of the table."""


def measure(trial: Trial) -> Row:
    """One row: the result of one command with the defaults, and whether it is what was asked for."""
    setup = trial.make()
    motion = trial.motion(setup)
    start = time.process_time()
    result = impose(setup, motion, None, "float64", Timing())
    seconds = time.process_time() - start
    after = result.assessment.after
    heights, walls = after.first_cell_height_ratio, after.wall_normal_deviation_deg
    layer = layers_kept(setup, result, motion) if result.repair else ("", "")
    return {
        "motion": trial.label,
        "asked": trial.asked,
        "reached": _reached(trial, setup, result, motion),
        "result": _outcome(setup, result, motion),
        "f_skew min": after.f_skew.min,
        "J min": after.min_relative_jacobian,
        "heights": f"{heights.min:.2f} to {heights.max:.2f}" if heights else "",
        "walls, deg rms": walls.rms if walls else np.nan,
        "layer J": layer[0],
        "layer height": layer[1],
        "attempts": len(result.attempts),
        "CPU s": seconds,
    }


def _reached(trial: Trial, setup: Setup, result: Result, motion: BoundaryMotion) -> str:
    after = result.assessment.after
    told = result.setup.topology.first[setup.boundary.known]
    wanted = setup.grid.points[told] + motion(1.0)[setup.boundary.known]
    exact = np.abs(result.grid.points[told] - wanted).max() < 1e-12 * np.ptp(setup.grid.points, axis=0).max()
    if trial.crossing:
        contact = setup.undeformed.contact(motion)
        named = contact is not None and all(name in contact.message for name in trial.crossing)
        return "yes" if named and exact and not result.valid else "**no**"
    good = after.f_skew.min >= trial.skew and after.min_relative_jacobian >= trial.jacobian
    return "yes" if result.valid and exact and good else "**no**"


def _outcome(setup: Setup, result: Result, motion: BoundaryMotion) -> str:
    if result.valid:
        return "valid"
    contact = setup.undeformed.contact(motion)
    names = " and ".join(dict.fromkeys(p for c in contact.crossings[:1] for p in c.patches)) if contact else ""
    return f"crossing of {names}" if contact else f"{result.assessment.after.invalid_cells} invalid cells"


def layers_kept(setup: Setup, result: Result, motion: BoundaryMotion) -> tuple[str, str]:
    """Ranges of the relative Jacobian at boundary-layer corners that the repair moved, and of the same over the
    relative area of the cell face across the shortest edge; empty without any."""
    plain = impose(setup.with_repair("off"), motion, 1, "float64", Timing()).grid.points
    moved = np.abs(result.grid.points - plain).max(axis=1) > 1e-12 * np.ptp(setup.grid.points, axis=0).max()
    found = [
        ratios
        for block in range(setup.grid.n_blocks)
        for ratios in _corner_ratios(
            *(setup.grid.block(block, v) for v in (setup.grid.points, result.grid.points, moved))
        )
    ]
    if not found:
        return "", ""
    return _range(np.concatenate([one for one, _ in found])), _range(np.concatenate([two for _, two in found]))


def _range(values: FloatArray) -> str:
    return f"{values.min():.2f} to {values.max():.2f}"


def _corner_ratios(before: FloatArray, after: FloatArray, moved: np.ndarray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """At thin corners of a block in space Jacobians relative to the undeformed ones, and heights: these over the area
    of the cell face across the shortest edge; nothing of 2-D blocks."""
    flat = [axis for axis in range(3) if before.shape[axis] == 1]
    for corner in np.ndindex(*(1 if axis in flat else 2 for axis in range(3))):
        edges = [[_edges(x, axis, corner) for axis in range(3) if axis not in flat] for x in (before, after)]
        lengths = np.stack([np.linalg.norm(e, axis=-1) for e in edges[0]])
        touched = _edges(moved.astype(float), 0 if 0 not in flat else 1, corner, ends=True)
        thin = (lengths.max(axis=0) > THIN * lengths.min(axis=0)) & (lengths.min(axis=0) > 0) & (touched > 0)
        if len(edges[0]) == 3 and thin.any():
            old, new = (np.einsum("...i,...i", e[0], np.cross(e[1], e[2]))[thin] for e in edges)
            shortest = lengths.argmin(axis=0)[thin]
            one, two = (_area_across([x[thin] for x in e], shortest) for e in edges)
            yield new / old, new / old * one / two


def _area_across(edges: list[FloatArray], axis: np.ndarray) -> FloatArray:
    """Area (n,) between the two of three edges (n, 3) that are not the one of number ``axis`` (n,)."""
    areas = [np.linalg.norm(np.cross(edges[k - 2], edges[k - 1]), axis=-1) for k in range(3)]
    return np.asarray(np.choose(axis, areas))


def _edges(x: np.ndarray, axis: int, corner: tuple[int, ...], ends: bool = False) -> np.ndarray:
    """At one corner of every cell the edge along ``axis``, or with ``ends`` the sum of its two ends."""
    here = tuple(slice(c, c + n - 1) if n > 1 else slice(None) for c, n in zip(corner, x.shape[:3], strict=True))
    other = tuple(
        slice(1 - c, 1 - c + n - 1) if a == axis else s
        for a, (c, n, s) in enumerate(zip(corner, x.shape[:3], here, strict=True))
    )
    return x[here] + x[other] if ends else x[other] - x[here]


def main() -> None:
    """The command line."""
    run(possible, lambda _, trial: measure(trial), __doc__, __file__)


def possible() -> dict[str, Trial]:
    """The trials whose grids are here, by name."""
    return {trial.label: trial for trial in TRIALS if trial.possible}


if __name__ == "__main__":
    main()
