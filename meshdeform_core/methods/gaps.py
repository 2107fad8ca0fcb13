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
from ..boundary.slip import Slip
from ..grid import BoolArray, FloatArray, IntArray
from ..numerics.arrays import lengths
from ..numerics.geometry.surface import TriangleTree
from ..parallel import Nodes
from .base import Account, Interpolation, Linearised, PreparedMethod, Problem, Progress, Setting
from .composite import Composite, Filler, PreparedComposite, on_faces
from .constraints import Constraints
from .kinks import BETWEEN, kinks_of
from .transfinite.tfi import TFI

OPEN = 0.8
"""Remaining fraction of its thickness below which a gap counts as closing (studies/default_method.py)."""
# Relative difference of equal distances.
_EQUAL = 1e-8
_TRANSFINITE = Composite(None, TFI(max_cells=0))


@dataclass(frozen=True)
class InGaps:
    """A composite that TFI gradually replaces where the gap between a moving wall and another boundary closes."""

    method: Composite

    @property
    def mover(self) -> Interpolation | None:
        """The first step of the method."""
        return self.method.mover

    @property
    def filler(self) -> Filler | None:
        """The second step of the method."""
        return self.method.filler

    def prepare(self, problem: Problem) -> PreparedMethod:
        """Bind to the undeformed grid; gaps are ignored with periodic boundaries, and if the whole boundary moves."""
        prepared = self.method.prepare(problem)
        moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
        if moving.all() or not moving.any() or problem.boundary.periodic.one.size:
            return prepared
        assert isinstance(prepared, PreparedComposite)
        return PreparedInGaps(prepared, problem, np.asarray(moving))


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


class PreparedInGaps:
    """A prepared composite, with TFI for closing gaps."""

    def __init__(self, method: PreparedComposite, problem: Problem, moving: BoolArray):
        self.method, self.problem, self._moving = method, problem, moving
        self._account = Account()
        why = "share of its thickness that a gap to a moving wall keeps before its cells follow both walls as TFI does"
        self._account.settings["open_gap"] = Setting(OPEN, why)

    @property
    def account(self) -> Account:
        """Settings and warnings of the method, and of the gaps."""
        merged = Account()
        merged.include(self.method.account)
        merged.include(self._account)
        return merged

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self.method.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        out = self.method.apply(displacement, progress)
        closing = self.closing(displacement)
        if closing is None:
            return out
        share, lines = self.spread(closing.share), self.transfinite.apply(displacement)

        def blend_rows(rows: slice) -> None:
            moved = out[rows]
            moved += share[rows] * (lines[rows] - moved)

        Nodes.of(out).each(blend_rows)
        if self.problem.boundary.slip.curved:
            self.method.constrain_again(out)
        return out

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative at a displacement (n_sources, 3)."""
        closing = self.closing(displacement)
        if closing is None:
            return self.method.linearised(displacement)
        self.problem.grid.nodes.require_whole("a derivative of a motion that closes a gap")
        return _LinearInGaps(self, closing, displacement)

    def equally_far(self, displacement: FloatArray, rows: IntArray) -> int:
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


class _LinearInGaps:
    """Derivative of the blend of the method with TFI, including that of the share of TFI."""

    def __init__(self, method: PreparedInGaps, closing: Closing, displacement: FloatArray) -> None:
        self._closing, self._share = closing, method.spread(closing.share)
        inside = (self._share > 0.0) & (self._share < 1.0)
        own = method.method.apply(displacement)
        apart = method.transfinite.apply(displacement) - own
        self._apart = inside * apart
        self._own = method.method.linearised(displacement)
        self._lines, self._scalar = (each.linearised(displacement) for each in (method.transfinite, method.scalar))
        self.kinks = self._own.kinks + self._lines.kinks
        self.kinks += kinks_of([(BETWEEN, method.equally_far(displacement, closing.rows))])
        # Blended nodes are projected back onto curved slip surfaces.
        self._problem, self._again = method.problem, None
        if self._problem.boundary.slip.curved:
            blend = own + self._share * apart
            self._again = Constraints(self._problem, on_faces(blend, self._problem))
            self.kinks += self._again.kinks

    def push(self, change: FloatArray) -> FloatArray:
        closing, out = self._closing, self._own.push(change)
        # In place, so that only one array is needed besides the result.
        more = self._lines.push(change)
        more -= out
        more *= self._share
        out += more
        del more
        share = np.zeros_like(change)
        share[closing.rows, 0] = np.einsum("ni,ni->n", closing.slope, change[closing.rows] - change[closing.other])
        more = self._scalar.push(share)
        np.multiply(self._apart, more[:, :1].copy(), out=more)
        out += more
        if self._again:
            self._again.impose(on_faces(out, self._problem), out)
        return out

    def pull(self, gradient: FloatArray) -> FloatArray:
        if self._again:
            face = self._again.gathered(gradient)
            gradient[self._problem.topology.first] += face
        closing, part = self._closing, np.zeros_like(gradient)
        part[:, 0] = np.einsum("ni,ni->n", gradient, self._apart)
        share = self._scalar.pull(part)[closing.rows, :1] * closing.slope
        np.multiply(gradient, self._share, out=part)
        gradient -= part
        found = self._lines.pull(part)
        del part
        found += self._own.pull(gradient)
        np.add.at(found, closing.rows, share)
        np.subtract.at(found, closing.other, share)
        return np.asarray(found)
