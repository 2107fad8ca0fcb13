"""Range of validity of each method and effect of its parameters: the evidence for the defaults."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from meshdeform_core.deform import Timing, impose
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import IDW, TFI, Options, Problem, make_method
from meshdeform_core.quality import assess
from meshdeform_core.quality.validity import newly_invalid

from .curves import draw_curves
from .experiment import Sample, prepare_sample
from .rows import Tell

_METHODS: dict[str, Options] = {
    "tfi-tfi": Options("tfi-tfi"),
    "rbf-rbf": Options("rbf-rbf"),
    "rbf-tfi": Options("rbf-tfi"),
    "idw-rbf": Options("idw-rbf"),
    "idw-idw": Options("idw-idw"),
    "idw-tfi": Options("idw-tfi"),
    "idw-idw, quaternion": Options("idw-idw", idw=IDW(rotation="quaternion")),
    "idw-idw, blend": Options("idw-idw", idw=IDW(rotation="blend")),
    "idw-idw, alpha 0.3": Options("idw-idw", idw=IDW(alpha=0.3)),
}
_QUICK = ("tfi-tfi", "rbf-tfi", "idw-idw", "idw-tfi")
_STEP, _FULL = 5.0, 90.0
T = TypeVar("T")


def study(folder: Path, quick: bool, tell: Tell) -> dict[str, Any]:
    """All curves of the splitter plate; writes their figures into ``folder``."""
    bench = Bench(8, tell)
    methods = {name: _METHODS[name] for name in _QUICK} if quick else _METHODS
    angles = (15, 30, 45) if quick else range(5, 65, 5)
    cells = (8, 16, 32, 0) if quick else (4, 8, 12, 16, 24, 32, 64, 0)
    alphas = (0.05, 0.1, 0.3) if quick else (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
    parts: dict[str, Any] = {"sample": f"splitter-plate {bench.size}", "sub_block_sample": "hemisphere 24"}
    parts["quality"] = [
        {"method": name, "points": [bench.point(options, float(angle)) for angle in angles]}
        for name, options in bench.each(methods, "quality against angle")
    ]
    repaired = (60.0,) if quick else (30.0, 60.0, 90.0, 120.0, 150.0)
    rows = [
        {
            "method": name,
            "one_step": bench.largest(options),
            "marching": bench.largest_marching(options),
            "repaired": bench.largest_repaired(options, repaired),
        }
        for name, options in bench.each(methods, "largest angle")
    ]
    parts["largest_angle"] = {"step": _STEP, "repaired": repaired, "rows": rows}
    # Five blocks around a body, each much larger than a sub-block: here sub-blocks matter.
    dome = Sample("hemisphere", 24, time=2.5e-4)
    parts["sub_blocks"] = [
        {"max_cells": n, **quality_of(dome, Options("idw-tfi", tfi=TFI(max_cells=n)))}
        for _, n in bench.each({f"max_cells {n}": n for n in cells}, "sub-blocks")
    ] + [{"max_cells": None, **quality_of(dome, Options("idw-idw"))}]
    parts["alpha"] = [
        {"alpha": alpha, "angle": angle, **bench.point(Options("idw-idw", idw=IDW(alpha=alpha)), angle)}
        for _, alpha in bench.each({f"alpha {a}": a for a in alphas}, "alpha")
        for angle in (15.0, 30.0, 35.0)
    ]
    return parts | {"figures": draw_curves(parts, folder)}


class Bench:
    """The splitter plate, bent as in the paper and rotated by any angle."""

    def __init__(self, size: int, tell: Tell):
        self.size, self.tell = size, tell

    def each(self, things: dict[str, T], what: str) -> Iterator[tuple[str, T]]:
        """Iterate over names and values, reporting progress."""
        for done, (name, value) in enumerate(things.items()):
            self.tell(f"{what}: {name}", done, len(things))
            yield name, value

    def point(self, options: Options, angle: float) -> dict[str, Any]:
        """Quality at one angle, in one step."""
        return quality_of(self._sample(angle), options) | {"angle": angle}

    def largest(self, options: Options) -> float:
        """Largest valid angle in one step: the last multiple of 5 degrees before the first that crosses cells."""
        angle = 0.0
        while angle < _FULL:
            setup = prepare_sample(self._sample(angle + _STEP))
            points = _moved(setup.problem, options, setup.displacement(0.0))
            if newly_invalid(setup.original, points).size:
                break
            angle += _STEP
        return angle

    def largest_marching(self, options: Options) -> float:
        """The same in steps of 5 degrees, each from the last grid; the plate bends in proportion."""
        setup = prepare_sample(self._sample(_FULL))
        count = round(_FULL / _STEP)
        points, done = setup.grid.points, np.zeros((setup.topology.n_unique, 3))
        for step in range(1, count + 1):
            target = setup.displacement(0.0, step / count)
            problem = dataclasses.replace(setup.problem, grid=setup.grid.moved(points))
            points = _moved(problem, options, target - done)
            if newly_invalid(setup.original, points).size:
                return (step - 1) * _STEP
            done = target
        return _FULL

    def largest_repaired(self, options: Options, angles: Iterable[float]) -> float:
        """The last of ``angles`` before the first at which one step and a repair leave invalid cells."""
        reached = 0.0
        for angle in angles:
            setup = prepare_sample(self._sample(angle))
            setup = dataclasses.replace(setup, case=dataclasses.replace(setup.case, method=options))
            result = impose(setup, partial(setup.displacement, 0.0), 1, "float64", Timing())
            if not result.valid:
                break
            reached = angle
        return reached

    def _sample(self, angle: float) -> Sample:
        return Sample("splitter-plate", self.size, constants=(("angle", angle),))


def quality_of(sample: Sample, options: Options) -> dict[str, Any]:
    """Quality measures of a sample deformed in one step."""
    setup = prepare_sample(sample)
    points = _moved(setup.problem, options, setup.displacement(sample.time))
    after = assess(setup.original, points, setup.boundary).after
    walls = after.wall_normal_deviation_deg
    return {
        "f_skew": after.f_skew.harmonic_mean,
        "f_skew_p01": after.f_skew.p01,
        "f_skew_min": after.f_skew.min,
        "invalid_cells": after.invalid_cells,
        "wall_deviation_rms_deg": walls.rms if walls else None,
    }


def _moved(problem: Problem, options: Options, displacement: FloatArray) -> FloatArray:
    """Nodes of ``problem`` after a displacement of all unique face nodes."""
    prepared = make_method(options).prepare(problem)
    return np.asarray(problem.grid.points + prepared.apply(displacement[problem.source_numbers]))
