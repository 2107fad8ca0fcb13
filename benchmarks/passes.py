"""Work that should run at memory speed (TFI, quality, topology), compared with the time of a copy."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cases import Motion, motion
from machine import copy_seconds
from tables import MarkdownTable, Row, best

from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import Options, PreparedMethod, make_method
from meshdeform_core.parallel import thread_count
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.validity import newly_invalid
from meshdeform_formats import write_grid

CASES = {"splitter-plate": (16, 32), "hemisphere": (48, 92)}
QUICK = {"splitter-plate": (8,), "hemisphere": (16,)}
_REPEATS = 7


def memory_speed(quick: bool) -> MarkdownTable:
    """Times per million nodes, and as multiples of copying the coordinate array."""
    table = MarkdownTable(
        "TFI, quality, topology against copying the coordinate array once",
        notes=[
            "copies, new copies: wall time with all threads, against copying with as many",
            "CPU copies: CPU time of all threads against that of a copy on one of them",
            "a level of a series: writing goes to a binary Plot3D file and includes making it",
        ],
    )
    for sample, sizes in (QUICK if quick else CASES).items():
        for size in sizes:
            with tempfile.TemporaryDirectory() as folder:
                table.rows += _rows(motion(sample, size), Path(folder) / "level.xyz")
    return table


def _rows(case: Motion, file: Path) -> list[Row]:
    grid = case.setup.grid
    copy, fresh = copy_seconds(grid.n_nodes, thread_count()), best(grid.points.copy, _REPEATS)
    alone = copy_seconds(grid.n_nodes, 1)
    rows = []
    for name, work in _works(case, file).items():
        work()
        seconds, cpu = best(work, _REPEATS), _cpu(work)
        rows.append(
            {
                "case": case.label,
                "nodes": grid.n_nodes,
                "what": name,
                "s": seconds,
                "s per million nodes": seconds / grid.n_nodes * 1e6,
                "copies": seconds / copy,
                "new copies": seconds / fresh,
                "CPU copies": cpu / alone,
            }
        )
    return rows


def _works(case: Motion, file: Path) -> dict[str, Callable[[], object]]:
    setup, grid = case.setup, case.setup.grid
    prepared = make_method(Options("tfi")).prepare(case.problem)
    after = grid.points + prepared.apply(case.displacement)
    hybrid = make_method(Options("idw-tfi"))
    filler = hybrid.filler.prepare(case.problem, hybrid.filler.skeleton(case.problem))
    field = np.zeros_like(grid.points)
    known = Original(grid, setup.topology)
    assess(known, after, setup.boundary)
    return {
        "TFI, whole apply": lambda: prepared.apply(case.displacement),
        "TFI of sub-blocks, filling": lambda: filler.fill(field),
        "TFI, set-up": lambda: make_method(Options("tfi")).prepare(case.problem),
        "a level by TFI: apply, quality, writing": lambda: _level(prepared, case, known, file),
        "quality, further level": lambda: assess(known, after, setup.boundary),
        "quality, before and after": lambda: assess(Original(grid, setup.topology), after, setup.boundary),
        "valid or not": lambda: newly_invalid(known, after),
        "topology": lambda: find_topology(grid),
    }


def _level(prepared: PreparedMethod, case: Motion, known: Original, file: Path) -> None:
    grid, setup = case.setup.grid, case.setup
    points = prepared.apply(case.displacement)
    points += grid.points
    assess(known, points, setup.boundary)
    write_grid(grid.moved(points), file)


def _cpu(work: Callable[[], object]) -> float:
    """Smallest CPU time of some runs."""
    seconds = []
    for _ in range(_REPEATS):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)
