"""Derivative of radial basis functions with greedily chosen centres; the choice is held fixed."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...grid import FloatArray
from ...parallel import require_whole
from ..base import Problem
from ..scattered.rbf import REACH, PreparedRBF
from ..scattered.rbf_sums import RadialSums
from .kinks import CHOSEN, Kinks
from .radial import RadialMap, accurate


class GreedyDerivative:
    """Derivative of the displacement of some nodes at one displacement (n_sources, 3) of the sources.

    It includes the interpolation between the chosen centres, the residual at all sources, which nodes near them take
    over, and the distance over which they do, which grows with the largest residual. The choice of centres is held
    fixed.
    """

    def __init__(self, method: PreparedRBF, problem: Problem, sums: RadialSums, displacement: FloatArray) -> None:
        require_whole(problem.grid.points, "a derivative of a greedy reduction")
        self._images, self._n, self.flat = method.images, len(problem.source_numbers), sums.flat
        self.kinks, images, centres = Kinks({CHOSEN: 1}), method.images, method.centres
        values = images.displaced(displacement)
        found = method.selected(values)
        self._active = found.active
        chosen = dataclasses.replace(centres, points=np.ascontiguousarray(centres.points[self._active]))
        system = accurate(method.options.system, chosen, problem)
        self._inside = RadialMap(system, problem.grid.points[self.flat])
        self._at_sources = RadialMap(system, images.points)
        left = values - self._at_sources.push(values[self._active])
        length = np.linalg.norm(left, axis=1)
        self._worst = int(np.argmax(length))
        reach = REACH * float(length[self._worst])
        self._corrects = method.options.greedy_correct and reach > 0.0
        if self._corrects:
            distance, self._nearest = sums.nearest()
            r = np.minimum(distance / reach, 1.0)
            self._share = ((1.0 - r) ** 4 * (4.0 * r + 1.0))[:, None]
            # The correction of a node depends on the reach, and the reach on the largest residual.
            self._growth = (20.0 * r**2 * (1.0 - r) ** 3 / reach)[:, None] * left[self._nearest]
            self._of_reach = REACH * left[self._worst] / length[self._worst]

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        values = self._images.displaced(change)
        moved = self._inside.push(values[self._active])
        if self._corrects:
            left = values - self._at_sources.push(values[self._active])
            moved += self._share * left[self._nearest] + self._growth * (self._of_reach @ left[self._worst])
        out[self.flat] = moved

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        g, values = gradient[self.flat], np.zeros((len(self._images.owner), 3))
        of_active = self._inside.pull(g)
        if self._corrects:
            np.add.at(values, self._nearest, self._share * g)
            values[self._worst] += self._of_reach * (self._growth * g).sum()
            of_active -= self._at_sources.pull(values)
        values[self._active] += of_active
        total = np.zeros((self._n, 3))
        np.add.at(total, self._images.owner, np.einsum("nij,ni->nj", self._images.reflection, values))
        return total
