"""How many smooth motions give a valid grid: random flows of the samples and of third-party grids.

python studies/random_flows.py                                        200 flows, table on stdout
python studies/random_flows.py --count 30 --grid wing --steps auto    a part of them
python studies/random_flows.py --method idw-tfi --method rbf-tfi      several methods
python studies/random_flows.py --write studies/RESULTS.md  put the rows in the table on the page

A flow carries all nodes of a grid to a grid that is valid; the program is given the boundary only. Flow n belongs to
grid n modulo the number of grids, whichever of them are run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flows import Terrain, available, case_of, flowed, terrain
from tables import Row, keep, show

from meshdeform_core.deform import Result, deform
from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import Options
from meshdeform_core.quality import assess
from meshdeform_core.repair.options import RepairOptions

GOOD = 0.8
"""Share of the smallest scaled Jacobian of the grid that the flow made, which the result should have."""


@dataclass(frozen=True)
class Setting:
    """How the program is called; ``None``: with the defaults."""

    method: str
    steps: int | str | None
    repair: str | None

    @property
    def label(self) -> str:
        parts = [self.method] * (self.method != "idw-tfi")
        parts += [f"{name} {value}" for name in ("steps", "repair") if (value := getattr(self, name)) is not None]
        return ", ".join(parts) or "defaults"

    def run(self, place: Terrain, seed: int, points: FloatArray) -> Result:
        case = case_of(place, seed, points, Options(self.method))
        if self.repair is not None:
            case = dataclasses.replace(case, repair=RepairOptions(self.repair))
        return deform(place.grid, case, steps=self.steps, precision="float64")


def measure(numbers: range, grids: list[str], wanted: list[str], settings: list[Setting]) -> Iterator[Row]:
    """One row per flow and setting; ``numbers`` count over all ``grids``, of which the ``wanted`` are run."""
    for index, name in enumerate(grids):
        mine = [n for n in numbers if n % len(grids) == index]
        if name not in wanted or not mine:
            continue
        place = terrain(name)
        for number in mine:
            points, gentleness = flowed(place, number)
            for setting in settings:
                start = time.process_time()
                result = setting.run(place, number, points)
                seconds = time.process_time() - start
                yield {
                    "flow": number,
                    "grid": name,
                    "nodes": place.grid.n_nodes,
                    "gentleness": gentleness,
                    "setting": setting.label,
                    **judge(result, points, place),
                    "cpu_s": seconds,
                }


def judge(result: Result, points: FloatArray, place: Terrain) -> dict[str, Any]:
    """Whether the grid is valid and its boundary where it was prescribed, ``points`` (n_nodes, 3), and how its smallest
    scaled Jacobian compares with that of the grid that the flow itself made."""
    setup, after = result.setup, result.grid.points
    given = setup.topology.first[setup.boundary.known]
    miss = float(np.abs(after[given] - points[given]).max()) / float(np.ptp(points, axis=0).max())
    return {
        "valid": bool(result.valid and miss < 1e-12),
        "boundary_miss": miss,
        "invalid_cells": result.assessment.after.invalid_cells,
        "reached": result.reached,
        "f_skew_min": result.assessment.after.f_skew.min,
        "scaled_jacobian": result.assessment.after.min_scaled_jacobian,
        "of_the_flow": assess(place.original, points, None).after.min_scaled_jacobian,
    }


def summary(rows: list[Row], settings: list[Setting]) -> list[Row]:
    """By grid the valid results of each setting, and those with cells nearly as good as the flow's."""
    table = []
    for grid in dict.fromkeys(row["grid"] for row in rows):
        mine = [row for row in rows if row["grid"] == grid]
        line: Row = {"grid": grid, "flows": len({row["flow"] for row in mine})}
        for setting in settings:
            own = [row for row in mine if row["setting"] == setting.label]
            line[setting.label] = sum(row["valid"] for row in own)
            good = sum(row["valid"] and row["scaled_jacobian"] >= GOOD * row["of_the_flow"] for row in own)
            line[f"{setting.label}: {GOOD:g} of the flow"] = good
        table.append(line)
    return table


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="number of flows over all grids (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first flow (%(default)s)")
    parser.add_argument("--grid", action="append", choices=available(), help="only these grids")
    parser.add_argument("--method", action="append", help="default: idw-tfi")
    parser.add_argument("--steps", action="append", type=lambda text: text if text == "auto" else int(text))
    parser.add_argument("--repair", action="append", choices=("off", "auto", "polish"))
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every flow's result")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the rows in the table on a page")
    options = parser.parse_args()
    settings = [
        Setting(method, steps, repair)
        for method in options.method or ["idw-tfi"]
        for steps in options.steps or [None]
        for repair in options.repair or [None]
    ]
    rows = []
    numbers = range(options.first, options.first + options.count)
    for row in measure(numbers, available(), options.grid or available(), settings):
        rows.append(row)
        print(f"{row['grid']} {row['flow']} {row['setting']}: {_words(row)}", file=sys.stderr, flush=True)
        keep(summary(rows, settings), options.write, __file__)
    show(summary(rows, settings), None, __file__)
    if options.json:
        record = {"settings": [dataclasses.asdict(setting) for setting in settings], "flows": rows}
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def _words(row: Row) -> str:
    verdict = "valid" if row["valid"] else f"{row['invalid_cells']} invalid cells"
    share = row["scaled_jacobian"] / row["of_the_flow"]
    return f"{verdict}, scaled Jacobian {share:.2f} of the flow's, {row['cpu_s']:.1f} s"


if __name__ == "__main__":
    main()
