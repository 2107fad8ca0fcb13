"""The cylinder of the Mesh Motion suite (High-Fidelity CFD Verification Workshop 2024): how near the methods come to
the affine map that the wall follows, and what becomes of a uniform flow.

python studies/workshop.py                               the table on stdout
python studies/workshop.py --only "case 1"               some of the rows
python studies/workshop.py --write studies/RESULTS.md    put the table in its place on the page
python studies/workshop.py --picture studies/workshop.png
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tables import Row, run

import meshdeform as md
from meshdeform_core.grid import FloatArray
from meshdeform_samples import folder

SAMPLE = "workshop-cylinder"
METHODS, SIZES, STRIDES = ("idw-tfi", "idw", "rbf", "tfi"), (8, 16, 32), (4, 2, 1)
ENDS = {1: (2.0, 0.025), 2: (40.0, 0.1)}
"""Last time and shortest interval of each case; the others are twice and four times as long."""
SWEPT = {1: (1.0,), 2: (3 / 2, -1 / 2), 3: (11 / 6, -7 / 6, 1 / 3)}
"""Backward differences by their order: factors of the volumes swept in the last intervals, the newest first."""


class Run(NamedTuple):
    case: int
    size: int
    method: str


RUNS = {f"case {c}, {n} cells, {m}": Run(c, n, m) for c, n, m in product(ENDS, SIZES, METHODS)}


def exact(points: FloatArray, case: int, t: float) -> FloatArray:
    """Where the suite's affine map brings ``points`` (..., 2)."""
    alpha = t**3 * (8.0 - 3.0 * t) / 16.0 if case == 1 else 0.3 * np.sin(6.0 * t) * t**6 / (t**6 + 1.0)
    psi, c, s = 1.0 + 0.5 * alpha, np.cos(np.pi * alpha), np.sin(np.pi * alpha)
    x, y = psi * points[..., 0], points[..., 1] / psi
    return np.stack([c * x - s * y, s * x + c * y + alpha], axis=-1)


def levels(case: int, size: int, method: str) -> Iterator[md.Step]:
    """All levels at the shortest interval."""
    name = "case.toml" if case == 1 else "case2.toml"
    mesh = md.prepare(md.sample(SAMPLE, size).grid, case=str(folder(SAMPLE) / name), method=method)
    end, interval = ENDS[case]
    for number in range(round(end / interval) + 1):
        yield mesh.deform(time=number * interval)


def plane(grid: md.Grid) -> FloatArray:
    """Nodes (blocks, n + 1, n + 1, 2)."""
    return np.array([block.reshape(*block.shape[:2], -1)[..., :2] for block in grid.blocks])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def worst(x: FloatArray) -> float:
    """The smallest scaled Jacobian: the sine of the angle at a corner of a cell."""
    i, j = np.diff(x, axis=1), np.diff(x, axis=2)
    i, j = (edge / np.linalg.norm(edge, axis=-1, keepdims=True) for edge in (i, j))
    return float(min(cross(a, b).min() for a, b in product((i[:, :, :-1], i[:, :, 1:]), (j[:, :-1], j[:, 1:]))))


def areas(x: FloatArray) -> FloatArray:
    return 0.5 * cross(x[:, 1:, 1:] - x[:, :-1, :-1], x[:, :-1, 1:] - x[:, 1:, :-1])


def gained(step: md.Step, previous: md.Step) -> FloatArray:
    """What the cells gain by their faces, from the volumes that these sweep."""
    swept = (block[:2] for block in step.swept_volumes(previous))
    return np.array([np.diff(i.squeeze(), axis=0) + np.diff(j.squeeze(), axis=1) for i, j in swept])


def accelerated(x: list[FloatArray], interval: float) -> float:
    """The largest acceleration of a node, by central differences."""
    turns = (c - 2.0 * b + a for a, b, c in zip(x, x[1:], x[2:], strict=False))
    return max(float(np.linalg.norm(turn, axis=-1).max()) for turn in turns) / interval**2


def flow(volumes: list[FloatArray], gains: list[FloatArray], order: int) -> tuple[list[float], float]:
    """Mass at every level of a uniform flow of density 1, and the largest change of its density in a cell."""
    masses, change = [volumes[0]], 0.0
    for n in range(1, len(volumes)):
        swept = SWEPT[min(n, order)]
        differences = np.convolve(swept, (1.0, -1.0))
        rate = sum(b * gains[n - 1 - k] for k, b in enumerate(swept))
        past = sum(a * masses[n - k] for k, a in enumerate(differences) if k)
        masses.append((rate - past) / differences[0])
        change = max(change, float(np.abs(masses[n] / volumes[n] - 1.0).max()))
    return [float(mass.sum()) for mass in masses], change


def measure(name: str, job: Run) -> Row:
    """One row: all levels of a case, the longer intervals from those of the shortest."""
    interval, disk = ENDS[job.case][1], np.pi / 4.0
    found, recent, valid = list[FloatArray](), deque[md.Step](maxlen=STRIDES[0] + 1), 0
    gains: dict[int, list[FloatArray]] = {stride: [] for stride in STRIDES}
    for number, step in enumerate(levels(*job)):
        found.append(plane(step.grid))
        recent.append(step)
        valid += step.valid
        for stride in STRIDES:
            if number and number % stride == 0:
                gains[stride].append(gained(step, recent[-1 - stride]))
    asked = [exact(found[0], job.case, n * interval) for n in range(len(found))]
    flows = {
        (stride, order): flow([areas(x) for x in found[::stride]], gains[stride], order)
        for stride, order in product(STRIDES, SWEPT)
    }
    mass = np.concatenate([each for each, _ in flows.values()])
    row: Row = {
        "motion": name,
        "valid": f"{valid} of {len(found)}",
        "J min": min(map(worst, found)),
        "exact": min(map(worst, asked)),
        "distance": f"{max(np.abs(x - y).max() for x, y in zip(found, asked, strict=True)):.1e}",
    }
    for head, x in (("acceleration", found), ("exact map's", asked)):
        row[head] = " / ".join(f"{accelerated(x[::s], s * interval):.3g}" for s in STRIDES)
    row |= {"mass": f"{mass[-1]:.6f}", "mass error": f"{np.abs(mass / disk - 1.0).max():.1e}"}
    changes = (max(flows[stride, order][1] for stride in STRIDES) for order in SWEPT)
    return row | {"density, orders 1 / 2 / 3": " / ".join(f"{change:.0e}" for change in changes)}


def draw(path: Path) -> None:
    """The grids of case 1 at t = 2 and the distances over time."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["font.size"] = 8
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    start, *grids, curve = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.5))
    for case, style in ((1, "-"), (2, ":")):
        for number, method in enumerate(METHODS):
            x = [plane(step.grid) for step, _ in zip(levels(case, 16, method), range(81), strict=False)]
            times = np.arange(len(x)) * ENDS[case][1]
            apart = [np.abs(y - exact(x[0], case, t)).max() for y, t in zip(x, times, strict=True)]
            curve.semilogy(times, np.maximum(apart, 1e-17), style, color=f"C{number}", label=f"{method}, case {case}")
            if case == 1 and method in ("idw-tfi", "tfi"):
                if method == "idw-tfi":
                    _lines(start, x[0], "t = 0")
                _lines(grids[method == "tfi"], x[-1], f"case 1, t = 2: {method}")
    curve.set(xlabel="t", title="distance from the exact affine map")
    curve.legend(fontsize=6, loc="center right")
    figure.savefig(path, dpi=120)


def _lines(axes, x: FloatArray, title: str) -> None:  # type: ignore[no-untyped-def]
    for block in x:
        for lines in (block, block.swapaxes(0, 1)):
            axes.plot(*lines.transpose(2, 1, 0), color="0.3", linewidth=0.4)
    axes.set(aspect="equal", title=title, xticks=[], yticks=[])


def main() -> None:
    """The command line."""
    if sys.argv[1:2] == ["--picture"]:
        draw(Path(sys.argv[2]))
    else:
        run(lambda: RUNS, measure, __doc__, __file__)


if __name__ == "__main__":
    main()
