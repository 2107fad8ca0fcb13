"""The largest angle by which the splitter plate's body turns in one step, without and with a repair, by each method.

python studies/largest_angles.py              table on stdout
python studies/largest_angles.py --only tfi   some of the methods

The warnings of ``meshdeform_core/methods/limits.py`` rest on the angles without a repair.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

from tables import Row, run

from meshdeform_core.deform import Timing, impose
from meshdeform_core.methods import IDW, Options
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

METHODS = {
    **{name: Options(name) for name in ("tfi-tfi", "rbf-rbf", "rbf-tfi", "idw-rbf", "idw-idw", "idw-tfi")},
    "idw-idw, quaternion": Options("idw-idw", idw=IDW(rotation="quaternion")),
    "idw-idw, blend": Options("idw-idw", idw=IDW(rotation="blend")),
    "idw-idw, alpha 0.3": Options("idw-idw", idw=IDW(alpha=0.3)),
}


def largest(options: Options, angles: range, repair: str) -> int:
    """The last of ``angles`` (degrees) before the first at which one step leaves invalid cells; 0 without one."""
    reached = 0
    for angle in angles:
        setup = prepare_sample(Sample("splitter-plate", 8, constants=(("angle", float(angle)),)))
        setup = dataclasses.replace(setup, case=dataclasses.replace(setup.case, method=options)).with_repair(repair)
        if not impose(setup, partial(setup.displacement, 0.0), 1, "float64", Timing()).valid:
            break
        reached = angle
    return reached


def row(name: str, options: Options) -> Row:
    plain, repaired = largest(options, range(5, 95, 5), "off"), largest(options, range(30, 180, 30), "auto")
    return {"method": name, "one step [deg]": plain, "with a repair [deg]": repaired}


if __name__ == "__main__":
    run(lambda: METHODS, row, __doc__, Path(__file__).name)
