"""New positions of surface points identified by number, as in SU2's motion files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import MotionError
from ...grid import FloatArray, IntArray
from ...numerics.arrays import places_among
from ...parallel import rows_at
from ..tables.matching import Matching, Nodes, SurfaceData
from ..tables.transfer import transfer
from .motion import FollowSequence, Imposed, PreparedStep, Step, level_at

_ROUGH = 3.0
"""If the displacements of neighbours typically differ by more than this many edges, the numbers belong to another
mesh."""


@dataclass(frozen=True)
class Positions:
    """New positions (n, 3), or (n, 2) in a plane grid, of the points with these numbers (n,)."""

    numbers: IntArray
    positions: FloatArray
    label: str

    def at(self, nodes: Nodes) -> SurfaceData:
        """The displacements of the points; numbering is that of the unstructured files that this program writes.

        Raises
        ------
        MotionError
            When a number does not denote a point on a block face, nodes have no new position, or neighbours move so
            differently that the numbers must belong to another mesh.
        """
        topology = nodes.topology
        beyond = np.flatnonzero((self.numbers < 0) | (self.numbers >= topology.n_unique))
        if beyond.size:
            raise MotionError(
                f"{self.label}: {beyond.size} numbers are not of points on block faces, the first "
                f"{self.numbers[beyond[0]]}; these have 0 to {topology.n_unique - 1}"
            )
        missing = np.flatnonzero(~np.isin(nodes.numbers, self.numbers))
        if missing.size:
            first = int(missing[0])
            raise MotionError(
                f"{self.label} has no position for {missing.size} of {len(nodes.numbers)} boundary nodes, the first "
                f"{nodes.label(first)}, number {nodes.numbers[first]}"
            )
        points = rows_at(nodes.grid.points, topology.first[self.numbers])
        moved = points.copy()
        kept = np.sort(np.argsort(np.ptp(nodes.grid.points, axis=0))[3 - self.positions.shape[1] :])
        moved[:, kept] = self.positions
        self._require_neighbours(moved - points, nodes)
        return SurfaceData(points, moved - points, np.empty((0, 3), dtype=np.int64), self.label)

    def _require_neighbours(self, displacement: FloatArray, nodes: Nodes) -> None:
        row = places_among(self.numbers, nodes.topology.n_unique)
        own = displacement[row[nodes.numbers]]
        a, b = nodes.faces[:, 0], nodes.faces[:, 1]
        edge = np.linalg.norm(nodes.points[a] - nodes.points[b], axis=1)
        apart = np.linalg.norm(own[a] - own[b], axis=1)
        if float(np.median(apart - _ROUGH * edge)) > 0:
            raise MotionError(
                f"{self.label}: neighbours move apart by several edges almost everywhere; its numbers seem to be those "
                "of another mesh than the one that `meshdeform convert` writes"
            )


@dataclass(frozen=True)
class FollowNumbers(Step):
    """Displacement from positions by number: one file, or one for each of ``times``, read when needed."""

    times: tuple[float, ...]
    read: Callable[[int], Positions]

    @property
    def names(self) -> frozenset[str]:
        return frozenset({"t"} if self.times else ())

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        if self.times:
            level_at(self.times, time)

    def prepare(self, nodes: Nodes) -> PreparedStep:
        exact = Matching("exact")
        if self.times:
            return FollowSequence(self.times, lambda n: self.read(n).at(nodes), exact).prepare(nodes)
        return Imposed(transfer(self.read(0).at(nodes), exact, nodes))
