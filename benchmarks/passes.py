"""What should run at memory speed: TFI, quality, topology, against the time of a copy."""

from __future__ import annotations

import numpy as np
from cases import Motion, motion
from machine import copy_seconds
from tables import MarkdownTable, Row, best

from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import Options, make_method
from meshdeform_core.parallel import thread_count
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.validity import newly_invalid

CASES = {"splitter-plate": (16, 32), "hemisphere": (48,)}
QUICK = {"splitter-plate": (8,), "hemisphere": (16,)}


def memory_speed(quick: bool) -> MarkdownTable:
    """Times per million nodes, and as multiples of copying the coordinate array with as many threads."""
    table = MarkdownTable("TFI, quality, topology against copying the coordinate array once")
    for sample, sizes in (QUICK if quick else CASES).items():
        for size in sizes:
            table.rows += _rows(motion(sample, size))
    return table


def _rows(case: Motion) -> list[Row]:
    setup, grid = case.setup, case.setup.grid
    copy, fresh = copy_seconds(grid.n_nodes, thread_count()), best(grid.points.copy, 7)
    prepared = make_method(Options("tfi")).prepare(case.problem)
    after = grid.points + prepared.apply(case.displacement)
    hybrid = make_method(Options("idw-tfi"))
    filler = hybrid.filler.prepare(case.problem, hybrid.filler.skeleton(case.problem))
    field = np.zeros_like(grid.points)
    works = {
        "TFI, whole apply": lambda: prepared.apply(case.displacement),
        "TFI of sub-blocks, filling": lambda: filler.fill(field),
        "TFI, set-up": lambda: make_method(Options("tfi")).prepare(case.problem),
        "quality, before and after": lambda: assess(Original(grid, setup.topology), after, setup.boundary),
        "valid or not": lambda: newly_invalid(setup.original, after),
        "topology": lambda: find_topology(grid),
    }
    rows = []
    for name, work in works.items():
        work()
        seconds = best(work, 7)
        rows.append(
            {
                "case": case.label,
                "nodes": grid.n_nodes,
                "what": name,
                "s": seconds,
                "s per million nodes": seconds / grid.n_nodes * 1e6,
                "copies": seconds / copy,
                "new copies": seconds / fresh,
            }
        )
    return rows
