"""The region that a repair moves: its energy, and the dependence of its nodes on the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.cell.foldover.hexahedra import Unknowns
from ...parallel import Halo
from .elements import Energy


class Slide(NamedTuple):
    """Nodes (k,) that remain on a surface: ``normals`` returns its unit normals (k, d) near coordinates (k, d),
    ``back`` projects coordinates onto it, ``slopes`` returns the derivatives (k, d, d) of both, first that of ``back``.
    """

    nodes: IntArray
    normals: Callable[[FloatArray], FloatArray]
    back: Callable[[FloatArray], FloatArray]
    slopes: Callable[[FloatArray], tuple[FloatArray, FloatArray]]


class Dealt(NamedTuple):
    """How ranks share a region. Each holds the elements around its unknowns and nodes, with copies of what belongs to
    others.

    ``rows``: the unknowns; ``nodes``; ``chunks`` (k + 1,): the elements whose energy this rank sums, from ``chunks[n]``
    to ``chunks[n + 1]`` at a time.
    """

    rows: Halo
    nodes: Halo
    chunks: IntArray

    @classmethod
    def alone(cls, energy: Energy) -> Dealt:
        """The share of a single process: everything."""
        nodes = energy.nodes
        none = Halo.alone(np.empty(0, dtype=np.int64))
        return cls(none, Halo.alone(np.arange(int(nodes.max(initial=-1)) + 1)), np.array([0, len(nodes)]))


@dataclass(frozen=True)
class Region:
    """Cells whose nodes are moved; nodes have local numbers and coordinates (n, d) in space or in the plane.

    ``fixed`` (n_unknowns, d, d) projects onto the directions in which unknowns may move, ignoring ``slides``.
    """

    energy: Energy
    unknowns: Unknowns
    fixed: FloatArray
    dealt: Dealt
    slides: tuple[Slide, ...] = ()

    @property
    def n_unknowns(self) -> int:
        return len(self.fixed)

    @cached_property
    def work(self) -> float:
        """Work of computing the second derivatives of all elements, see :mod:`..limit`."""
        chunks = self.dealt.chunks
        count = self.energy.samples_of(int(chunks[0]), int(chunks[-1]))
        return self.energy.work * int(self.dealt.rows.joined(np.array([count])).sum())

    @property
    def dimension(self) -> int:
        return self.fixed.shape[1]

    @property
    def number(self) -> IntArray:
        return self.unknowns.number

    def directions(self, x: FloatArray) -> tuple[Unknowns, FloatArray]:
        """Dependence of nodes at ``x`` (n, d) on the unknowns, and projectors onto the directions of these."""
        if not self.slides:
            return self.unknowns, self.fixed
        frame, plain, freedom = self.unknowns.frame.copy(), self.unknowns.plain.copy(), self.fixed.copy()
        for slide in self.slides:
            across = slide.normals(x[slide.nodes])
            unknown = self.number[slide.nodes]
            freedom[unknown] -= across[:, :, None] * across[:, None, :]
            frame[slide.nodes], plain[slide.nodes] = freedom[unknown], False
        return Unknowns(self.number, frame, plain), freedom

    def moved(self, x: FloatArray, unknowns: Unknowns, step: FloatArray, length: float) -> FloatArray:
        """Coordinates after ``length`` times the step (n_unknowns, d) of the unknowns."""
        number, frame, plain = unknowns
        free = number >= 0
        move = step[number[free]]
        turned = ~plain[free]
        move[turned] = np.einsum("nij,nj->ni", frame[free][turned], move[turned])
        result = x.copy()
        result[free] += length * move
        for slide in self.slides:
            result[slide.nodes] = slide.back(result[slide.nodes])
        return result
