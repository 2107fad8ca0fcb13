"""Which method is best for which motion: one step of large motions, without repair.

python studies/which_method.py                       the table on stdout
python studies/which_method.py --only beam           some of the motions
python studies/which_method.py --write studies/RESULTS.md  put the table in its place on the page
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from motions import JOBS, Job
from tables import Row, show

from meshdeform_core.methods import IDW, Options, make_method
from meshdeform_core.quality import assess

METHODS: dict[str, Options] = {
    "idw-tfi": Options("idw-tfi"),
    "idw": Options("idw-idw"),
    "idw, by weights": Options("idw-idw", idw=IDW(transition=0)),
    "rbf-tfi": Options("rbf-tfi"),
    "tfi": Options("tfi-tfi"),
    "idw, none": Options("idw-idw", idw=IDW(rotation="none")),
    "idw, blend": Options("idw-idw", idw=IDW(rotation="blend")),
    "idw, quaternion": Options("idw-idw", idw=IDW(rotation="quaternion")),
}


def measure(jobs: list[Job], methods: dict[str, Options]) -> Iterator[Row]:
    """Smallest relative Jacobian, wall deviation and f_skew of every motion and method."""
    for job in jobs:
        setup, displacement = job.make()
        for name, options in methods.items():
            prepared = make_method(options).prepare(setup.problem)
            after = assess(setup.original, setup.grid.points + prepared.apply(displacement), setup.boundary).after
            walls = after.wall_normal_deviation_deg
            yield {
                "motion": job.label,
                "method": name,
                "invalid": after.invalid_cells,
                "relative_jacobian": after.min_relative_jacobian,
                "wall_deg": walls.rms if walls else np.nan,
                "f_skew": after.f_skew.harmonic_mean,
            }


def table(rows: list[Row]) -> list[Row]:
    """One line per motion: ``relative Jacobian / wall deviation / f_skew``; the best valid Jacobian in bold."""
    lines = []
    for motion in dict.fromkeys(row["motion"] for row in rows):
        mine = [row for row in rows if row["motion"] == motion]
        best = max((row["relative_jacobian"] for row in mine if not row["invalid"]), default=np.inf)
        line: Row = {"motion": motion}
        for row in mine:
            line[row["method"]] = _cell(row, best)
        lines.append(line)
    return lines


def _cell(row: Row, best: float) -> str:
    if row["invalid"]:
        return f"{row['invalid']} invalid"
    ratio = f"{row['relative_jacobian']:.2f}"
    bold = f"**{ratio}**" if row["relative_jacobian"] >= 0.97 * best else ratio
    return f"{bold} / {row['wall_deg']:.1f} / {_decimals(row['f_skew'])}"


def _decimals(value: float) -> str:
    return f"{value:.3f}".removeprefix("0")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="TEXT", default="", help="motions whose name contains this")
    parser.add_argument("--method", action="append", choices=METHODS, help="only these methods")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table between its marks on a page")
    options = parser.parse_args()
    jobs = [job for job in JOBS if job.possible and options.only in job.label]
    rows = []
    for row in measure(jobs, {name: METHODS[name] for name in options.method or METHODS}):
        rows.append(row)
        print(
            f"{row['motion']}; {row['method']}: {_cell(row, np.inf)} {row['f_skew']:.4f}", file=sys.stderr, flush=True
        )
    show(table(rows), options.write, __file__)


if __name__ == "__main__":
    main()
