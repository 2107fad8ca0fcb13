"""Closing gaps between moving walls and other boundaries, where TFI gradually replaces the method.

A method that moves the cells at a wall rigidly needs room for them. A gap that loses its thickness has none: its cells
must share the remaining space, which they do with transfinite interpolation between both walls.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from ..boundary import Kind
from ..boundary.constraints import Slip
from ..grid import FloatArray, IntArray
from ..numerics.arrays import lengths
from ..numerics.geometry.surface import TriangleTree
from ..parallel import Nodes
from .base import Account, Kinks, Linearised, PreparedMethod, Problem, Progress, Setting
from .composite import Composite, PreparedComposite, on_faces
from .constraints import Constraints, add_to_faces, impose
from .limits import BETWEEN
from .transfinite.tfi import TFI

OPEN = 0.8
"""Remaining fraction of its thickness below which a gap counts as closing (studies/default_method.py)."""
# Relative difference of equal distances.
_EQUAL = 1e-8
_TRANSFINITE = Composite(None, TFI(max_cells=0))


@dataclass(frozen=True)
class Closing:
    """How far gaps have closed at the sources: ``share`` (n_sources,) from 0 (open) to 1 (closed).

    ``rows`` (m,) are the sources with a share, ``other`` (m,) the sources across the gap, ``slope`` (m, 3) the
    derivative of the share with respect to the displacement of ``rows`` minus that of ``other``.
    """

    share: FloatArray
    rows: IntArray
    other: IntArray
    slope: FloatArray


class PreparedInGaps(PreparedComposite):
    """A prepared composite that TFI gradually replaces where the gap between a moving wall and another boundary closes;
    without gaps, as where periodic boundaries are or the whole boundary moves, the composite itself."""

    def __init__(self, method: Composite, problem: Problem):
        super().__init__(method, problem)
        self._moving = np.asarray(problem.boundary.kind[problem.source_numbers] == Kind.MOVING)
        self._has_gaps = 0 < self._moving.sum() < len(self._moving) and not problem.boundary.periodic.nodes.size

    @property
    def account(self) -> Account:
        merged = super().account
        if self._has_gaps:
            why = "share of its thickness that a gap to a moving wall keeps before its cells follow both walls as TFI "
            merged.settings["open_gap"] = Setting(OPEN, why + "does")
        return merged

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        out = super().apply(displacement, progress)
        closing = self.closing(displacement)
        if closing is None:
            return out
        share, lines = self.spread(closing.share), self.transfinite.apply(displacement)

        def blend_rows(rows: slice) -> None:
            moved = out[rows]
            moved += share[rows] * (lines[rows] - moved)

        Nodes.of(out).each(blend_rows)
        if self.problem.boundary.slip.curved:
            impose(self.problem, on_faces(out, self.problem), out)
        return out

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative of the blend of the method with TFI, including that of the share of TFI."""
        problem, closing = self.problem, self.closing(displacement)
        own_derivative = super().linearised(displacement)
        if closing is None:
            return own_derivative
        problem.grid.nodes.require_whole("a derivative of a motion that closes a gap")
        share = self.spread(closing.share)
        own = super().apply(displacement)
        apart = self.transfinite.apply(displacement) - own
        lines, scalar = (each.linearised(displacement) for each in (self.transfinite, self.scalar))
        kinks = own_derivative.kinks + lines.kinks
        kinks += Kinks({BETWEEN: self._equally_far(displacement, closing.rows)})
        again = None
        if problem.boundary.slip.curved:
            # Blended nodes are projected back onto curved slip surfaces.
            again = Constraints(problem, on_faces(own + share * apart, problem))
            kinks += again.kinks
        apart *= (share > 0.0) & (share < 1.0)
        del own

        def push(change: FloatArray) -> FloatArray:
            out = own_derivative.push(change)
            # In place, so that only one array is needed besides the result.
            more = lines.push(change)
            more -= out
            more *= share
            out += more
            del more
            of_share = np.zeros_like(change)
            rows, other = closing.rows, closing.other
            of_share[rows, 0] = np.einsum("ni,ni->n", closing.slope, change[rows] - change[other])
            more = scalar.push(of_share)
            np.multiply(apart, more[:, :1].copy(), out=more)
            out += more
            if again:
                again.impose(on_faces(out, problem), out)
            return out

        def pull(gradient: FloatArray) -> FloatArray:
            if again:
                add_to_faces(again.gathered(gradient), problem.topology, gradient)
            part = np.zeros_like(gradient)
            part[:, 0] = np.einsum("ni,ni->n", gradient, apart)
            of_share = scalar.pull(part)[closing.rows, :1] * closing.slope
            np.multiply(gradient, share, out=part)
            gradient -= part
            found = lines.pull(part)
            del part
            found += own_derivative.pull(gradient)
            np.add.at(found, closing.rows, of_share)
            np.subtract.at(found, closing.other, of_share)
            return np.asarray(found)

        return Linearised(push, pull, kinks)

    def _equally_far(self, displacement: FloatArray, rows: IntArray) -> int:
        """Number of sources among ``rows`` that two nodes across the gap are nearest to, after a displacement."""
        points, count = self.problem.source_points + displacement, 0
        for side in (self._moving, ~self._moving):
            across = points[~side]
            if len(across) > 1:
                distance, _ = scipy.spatial.cKDTree(across).query(points[rows[side[rows]]], k=2)
                count += int(np.count_nonzero(distance[:, 1] <= (1.0 + _EQUAL) * distance[:, 0]))
        return count

    @cached_property
    def transfinite(self) -> PreparedMethod:
        """TFI on the whole grid, prepared when a gap closes for the first time."""
        return _TRANSFINITE.prepare(self.problem)

    @cached_property
    def scalar(self) -> PreparedMethod:
        """:attr:`transfinite` without constraints, for scalars instead of displacements."""
        boundary = dataclasses.replace(self.problem.boundary, slip=Slip())
        return _TRANSFINITE.prepare(dataclasses.replace(self.problem, boundary=boundary))

    def spread(self, share: FloatArray) -> FloatArray:
        """Values (n_nodes, 1) from 0 to 1 at all nodes, by TFI of the values (n_sources,) at the sources."""
        found = self.scalar.apply(np.outer(share, [1.0, 0.0, 0.0]))
        result: FloatArray = Nodes.of(found).like(1)
        Nodes.of(result).each(lambda rows: np.clip(found[rows][:, :1], 0.0, 1.0, out=result[rows]))
        return result

    @cached_property
    def _gap(self) -> FloatArray:
        """Distance (n_sources,) of every moving source from the nearest resting one, and vice versa."""
        return self._across(self.problem.source_points)[0]

    def _across(self, points: FloatArray, within: FloatArray | None = None) -> tuple[FloatArray, IntArray]:
        distance, other = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        for side in (self._moving, ~self._moving):
            rows = np.flatnonzero(~side)
            # Points as degenerate triangles: importing scipy's tree would take longer than the search.
            tree = TriangleTree(points[rows], np.repeat(np.arange(len(rows)), 3).reshape(-1, 3))
            nearest, _, distance[side] = tree.closest(points[side], within if within is None else within[side])
            other[side] = rows[nearest]
        return distance, other

    def closing(self, displacement: FloatArray) -> Closing | None:
        """Where gaps close for a displacement (n_sources, 3) of the sources; ``None`` if all remain open."""
        if not self._has_gaps:
            return None
        longest = float(lengths(displacement).max())
        if longest <= (1.0 - OPEN) * float(self._gap.min()):
            return None
        points = self.problem.source_points + displacement
        # Sources farther apart than this distance are in no closing gap; the factor allows for round-off.
        distance, other = self._across(points, OPEN * (1.0 + 1e-9) * self._gap)
        # Boundaries that touch in the undeformed grid without sharing nodes have no gap.
        part = np.divide(distance, self._gap, out=np.full(len(distance), np.inf), where=self._gap > 0.0) / OPEN
        rows = np.flatnonzero(part < 1.0)
        if not rows.size:
            return None
        t, share = part[rows], np.zeros(len(part))
        share[rows] = 1.0 - t * t * (3.0 - 2.0 * t)
        arm = points[rows] - points[other[rows]]
        away = np.divide(arm, distance[rows, None], out=np.zeros_like(arm), where=distance[rows, None] > 0.0)
        slope = (-6.0 * t * (1.0 - t) / (OPEN * self._gap[rows]))[:, None] * away
        return Closing(share, rows, other[rows], slope)
