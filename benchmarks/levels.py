"""Cost of a level of a series: the first and further ones."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cases import Motion, motion, shortest_edges
from runs import make_sample
from tables import MarkdownTable, Row

from meshdeform_core.deform import set_up
from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.memory import Demand, deforming
from meshdeform_core.methods import CATALOGUE, Options, make_method
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case

METHODS = tuple(CATALOGUE)


def of_every_method(quick: bool) -> MarkdownTable:
    """CPU seconds of preparation and of levels, for every method."""
    table = MarkdownTable(
        "Levels, CPU seconds of all threads",
        notes=[
            "first: the first displacement after the preparation, with all that is made when it is first needed",
            "second, further: the same motion with other amplitudes by place; IDW lists its clusters anew where the "
            "largest displacement or rotation passes a power of four",
        ],
    )
    for name in METHODS:
        # Loops are compiled, or loaded, at their first use.
        _levels(motion("splitter-plate", 8), name)
    for sample, size in (("splitter-plate", 8), ("hemisphere", 16)) if quick else (("hemisphere", 48),):
        table.rows += [_levels(motion(sample, size), name) for name in METHODS]
    return table


def _levels(case: Motion, name: str) -> Row:
    problem, d = case.problem, case.displacement
    place = problem.source_points / np.abs(problem.source_points).max()
    start = time.process_time()
    prepared = make_method(Options(name)).prepare(problem)
    row = {"case": case.label, "nodes": case.setup.grid.n_nodes, "method": name, "set-up": time.process_time() - start}
    row["first"] = _cpu(prepared.apply, d)
    for which, size, waves in (("second", 1.0, 7.0), ("further", 0.8, 5.0)):
        row[which] = _cpu(prepared.apply, size * d * (1.0 + 0.1 * np.cos(waves * place)))
    row["further / first"] = row["further"] / row["first"]
    return row


def _cpu(work: Callable[[FloatArray], object], displacement: FloatArray) -> float:
    start = time.process_time()
    work(displacement)
    return time.process_time() - start


@dataclass(frozen=True)
class _Compared:
    """Series to run on a sample: methods, and of how many levels one is compared with a run of its own."""

    sample: str
    size: int
    motion: str
    methods: tuple[str, ...]
    every: int = 1
    capped: tuple[str, ...] = ()


_SERIES = (
    _Compared("hemisphere", 16, "period", ("rbf-tfi", "tfi"), 1, ("tfi",)),
    _Compared("hemisphere", 16, "period", ("rbf", "idw-tfi"), 5, ("rbf", "idw-tfi")),
    _Compared("splitter-plate", 8, "period", ("idw-tfi",)),
    _Compared("hemisphere", 16, "noise", ("rbf", "idw-tfi"), 10),
    _Compared("hemisphere", 48, "period", ("rbf-tfi",), 10, ("rbf-tfi",)),
)
_QUICK = (
    _Compared("hemisphere", 8, "period", ("rbf-tfi", "tfi"), 1, ("tfi",)),
    _Compared("hemisphere", 8, "noise", ("rbf",), 5),
)
_CAPS = (3, 6, 12, 24, 48)
"""Coordinate arrays left to the method by the caps that are tried; the least that it accepts is taken."""


def hundred_levels(quick: bool) -> MarkdownTable:
    """Series of levels through the command line against the method prepared anew for every level."""
    table = MarkdownTable(
        "Series, file to file, against single levels",
        notes=[
            "period: the case's formula times the sine of the time (the splitter plate: rotations of different "
            "angles); noise: a table for each level, of a mode that swings and noise of half a per cent",
            "difference: largest distance of a node from where the method puts it when it is prepared anew and knows "
            "of no other level, of the levels compared, relative to the largest displacement; cells: the same in units "
            "of the shortest edge at the node, in which the tolerance of fast sums (0.01) is given",
            "allowed: --max-memory for the grid and the least that the method accepts; with less room for undeformed "
            "cells and lists, results are the same",
        ],
    )
    levels = 10 if quick else 100
    with tempfile.TemporaryDirectory() as name:
        for each in _QUICK if quick else _SERIES:
            folder = make_sample(Path(name), each.sample, each.size)
            case = _noisy(folder, levels) if each.motion == "noise" else _swing(folder, each.sample, levels)
            table.rows += [_series(case, method, each.every) for method in each.methods]
            table.rows += [_capped(case, method, each.every) for method in each.capped]
    return table


@dataclass(frozen=True)
class _Case:
    """A grid, a case file beside it, the times of the levels, and what the motion is called."""

    folder: Path
    file: str
    times: str
    motion: str


def _swing(folder: Path, sample: str, levels: int) -> _Case:
    """Let the sample's motion depend on the time, with a period of one."""
    text = (folder / "case.toml").read_text(encoding="utf-8")
    text = text.replace("2*pi*frequency*t", "2*pi*t").replace("frequency = 1e3\n", "")
    text = text.replace('angle = "angle"', 'angle = "angle*sin(2*pi*t)"') if sample == "splitter-plate" else text
    (folder / "period.toml").write_text(text, encoding="utf-8")
    return _Case(folder, "period.toml", f"0:{1 - 1 / levels:.12g}:{1 / levels}", "period")


def _noisy(folder: Path, levels: int) -> _Case:
    """A table for each level on the membrane of the hemisphere."""
    grid = read_grid(folder / "grid.cgns")
    nodes = grid.points[find_topology(grid).first]
    radius = float(np.linalg.norm(nodes, axis=1).min())
    wall = nodes[np.linalg.norm(nodes, axis=1) < radius * (1 + 1e-9)]
    height, rng = wall[:, 2:] / radius, np.random.default_rng(0)
    for level in range(levels):
        moved = 0.05 * radius * np.sin(0.3 * level) * height * wall / radius * [[1.0, 0.5, 2.0]]
        moved += 2.5e-4 * radius * height * rng.standard_normal(wall.shape)
        rows = np.hstack([wall, moved])
        np.savetxt(folder / f"noise_{level:03d}.csv", rows, "%.17g", delimiter=",", header="x,y,z,dx,dy,dz")
    text = (
        '[[boundary]]\nname = "membrane"\nselect = ["membrane"]\n'
        f'motion = [{{ files = "noise_*.csv", times = "0:{levels - 1}:1" }}]\n\n'
        '[[boundary]]\nname = "rigid"\nselect = ["plate", "outer"]\nkind = "fixed"\n'
    )
    (folder / "noise.toml").write_text(text, encoding="utf-8")
    return _Case(folder, "noise.toml", "", "noise")


def _capped(case: _Case, method: str, every: int) -> Row:
    """The same with the least memory that the method accepts."""
    grid = read_grid(case.folder / "grid.cgns")
    for arrays in _CAPS:
        cap = Demand.of("deforming", deforming(method, beside=24 * arrays), grid).in_memory
        try:
            return _series(case, method, every, str(cap))
        except subprocess.CalledProcessError as error:
            if error.returncode != 2:
                raise
    raise RuntimeError(f"{method} accepts none of the caps")


def _series(case: _Case, method: str, every: int, cap: str = "") -> Row:
    folder = case.folder
    out, report = folder / "out", folder / "report.json"
    report.unlink(missing_ok=True)
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "meshdeform", "series", f"{folder}/grid.cgns", "-c", f"{folder}/{case.file}"]
    command += ["-m", method, "-o", str(out), "--suffix", ".xyz", "--repair", "off", "--allow-invalid", "-q"]
    command += [*(["--times", case.times] if case.times else []), "--report", str(report)]
    command += ["--max-memory", cap] if cap else []
    start = time.perf_counter()
    # A cap that is refused is no fault worth telling.
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL if cap else None)
    wall = time.perf_counter() - start
    told = json.loads(report.read_text(encoding="utf-8"))
    compared = told["levels"][every // 2 :: every]
    difference, in_cells = _difference(case, method, compared)
    shutil.rmtree(out)
    return {
        "case": folder.name, "motion": case.motion, "method": method, "levels": len(told["levels"]),
        "wall s": wall, "compared": len(compared), "difference": difference, "cells": in_cells,
        "peak MB": told["peak_memory_bytes"] / 1e6,
        "allowed MB": float(cap) / 1e6 if cap else "",
    }  # fmt: skip


def _difference(case: _Case, method: str, levels: list[Row]) -> tuple[float, float]:
    """Relative to the largest displacement, and in shortest cell edges at the node."""
    folder = case.folder
    grid = read_grid(folder / "grid.cgns")
    what = read_case(folder / case.file, (), method, None).case
    setup = set_up(grid, what)
    prepared, apart, moved, cells = make_method(what.method), 0.0, 0.0, 0.0
    edges = shortest_edges(grid, np.arange(grid.n_nodes))
    for level in levels:
        displacement = setup.displacement(level["time"])[setup.problem.source_numbers]
        single = prepared.prepare(setup.problem).apply(displacement)
        found = read_grid(folder / "out" / level["file"]).points - grid.points
        gap = np.linalg.norm(found - single, axis=1)
        apart, moved = max(apart, float(gap.max())), max(moved, float(np.abs(single).max()))
        cells = max(cells, float((gap / edges).max()))
    return apart / moved, cells
