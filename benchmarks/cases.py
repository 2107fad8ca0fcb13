"""The sample cases at any size, set up in memory."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from meshdeform_core.deform import Setup, set_up
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.methods import Problem
from meshdeform_formats.case import read_case
from meshdeform_samples import folder, load

# The hemisphere moves as sin(2 pi 1000 t): the instant of the largest deformation.
TIMES = {"hemisphere": 2.5e-4}


@dataclass(frozen=True)
class Motion:
    """A set-up case and the displacement (n_sources, 3) of its sources."""

    sample: str
    size: int
    setup: Setup
    problem: Problem
    displacement: FloatArray

    @property
    def label(self) -> str:
        return f"{self.sample} {self.size}"


@functools.lru_cache(maxsize=1)
def motion(sample: str, size: int) -> Motion:
    """The sample's grid and the motion of its case file; the last one is kept."""
    setup = set_up(load(sample).generate(size), read_case(folder(sample) / "case.toml", (), None, None).case)
    problem = setup.problem
    displacement = setup.displacement(TIMES.get(sample, 0.0))[problem.source_numbers]
    return Motion(sample, size, setup, problem, displacement)


def inner_nodes(problem: Problem) -> IntArray:
    """Flat indices of the unique nodes that are not sources: the targets of IDW and RBF alone."""
    topology = problem.topology
    wanted = np.ones(problem.grid.n_nodes, dtype=bool)
    wanted[topology.face_nodes] = False
    unknown = np.ones(topology.n_unique, dtype=bool)
    unknown[problem.source_numbers] = False
    wanted[topology.first[unknown]] = True
    return np.flatnonzero(wanted)


def shortest_edges(grid: Grid, flat: IntArray) -> FloatArray:
    """Shortest non-zero edge at each of the nodes ``flat`` within its block: the local cell size."""
    block = np.searchsorted(grid.offsets, flat, side="right") - 1
    shapes = np.array(grid.shapes)[block]
    local = flat - grid.offsets[block]
    strides = np.stack([shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones_like(flat)], axis=1)
    shortest = np.full(len(flat), np.inf)
    for axis in range(3):
        index = local // strides[:, axis] % shapes[:, axis]
        for step, inside in ((-1, index > 0), (1, index < shapes[:, axis] - 1)):
            other = np.where(inside, flat + step * strides[:, axis], flat)
            length = np.linalg.norm(grid.points[other] - grid.points[flat], axis=1)
            shortest = np.minimum(shortest, np.where(length > 0, length, np.inf))
    return shortest
