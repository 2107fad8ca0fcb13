"""Derivative of inverse distance weighting: rigid motions of the sources, their sums, and the motion of the nodes."""

from __future__ import annotations

import numpy as np

from ...grid import BoolArray, FloatArray, Grid, IntArray
from ...numerics.fastsum.weighted.sums import FastSums, Scaled
from ...numerics.rigid import finish
from ...numerics.tangents import finish_gradients, finish_tangents
from ...numerics.tape import Tracked, plain
from ...parallel import Nodes, agreed, empty
from ..kinks import Kinks
from .fast_idw_sums import FastEvaluator, fast_sums
from .idw_sums import Bound, ExactEvaluator, ExactSums, SourceValues, Use, Weights
from .summation import DERIVATIVE_TOLERANCE, MAX_RETRIES, doubtful

_FIRST_SHARE = 1.7
"""Initial error allowed to one cluster, as a multiple of that allowed to the sum; sufficient on the hemispheres, while
the plates need half of it."""
# Nodes per chunk when fast sums are checked.
_CHECKED = 64

Sums = ExactSums | FastSums


class LinearIDW:
    """Derivative of the displacement of the nodes of an evaluator at one displacement (n_sources, 3) of the sources.

    Sums over sources become sums of derivatives, exact or fast like those of the method, and their transposes are sums
    over nodes.

    Parameters
    ----------
    variable : the displacement, from which ``fit`` of the sources that move, and of one of the others, was recorded
    acting : (n,) the images of sources that move
    alpha, slope : alpha if it depends on the displacement, and the derivative of the factor of r^-b with respect to it
    """

    def __init__(
        self, evaluator: ExactEvaluator | FastEvaluator, variable: Tracked, fit: SourceValues, acting: BoolArray,
        alpha: Tracked | None, slope: float, kinks: Kinks,
    ) -> None:  # fmt: skip
        self._bound, self._tape, self._variable = evaluator.bound, variable.tape, variable.number
        self._fit, self._slope, self.kinks = fit, slope, kinks
        self._transition = fit.transition._replace(rest=plain(fit.transition.rest))
        wanted = {
            "values": fit.values, "shift": fit.frame.shift, "turn": fit.frame.turn,
            "rest": fit.transition.rest, "alpha": alpha,
        }  # fmt: skip
        self._numbers = {name: each.number for name, each in wanted.items() if isinstance(each, Tracked)}
        kept = plain(fit.values), acting, isinstance(evaluator, FastEvaluator), self._transition.width > 0.0
        self._sums, self._base = _accurate(self._bound, fit.weights, *kept)
        self._near = None
        if slope:
            # The part of the weights that alpha multiplies.
            near = tuple((b, 5.0, 0.0) for _, b, _ in fit.weights)
            _, self._near = _accurate(self._bound, near, *kept)

    @property
    def flat(self) -> IntArray:
        """Flat indices (n,) of the target nodes."""
        return self._bound.flat

    def _turned(self) -> FloatArray | None:
        turn = self._fit.frame.turn
        return None if turn is None else plain(turn)

    def _seen(self, sums: FloatArray, flat: IntArray) -> FloatArray:
        """Displaced positions (n, 3) within the frame, relative to the centre of the mean rotation."""
        assert self._fit.frame.centre is not None
        bound, points = self._bound, self._bound.points[flat]
        moved = np.empty_like(points)
        finish(bound.rotation, sums, points - self._fit.origin, moved, bound.repeats, self._transition)
        return np.asarray(moved + points - self._fit.frame.centre)

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        found = dict(
            zip(self._numbers, self._tape.push({self._variable: change}, list(self._numbers.values())), strict=True)
        )
        bound, turn, rest = self._bound, self._turned(), found.get("rest", np.zeros(6))
        values, common = _apart(found["values"], self._sums.acting)

        def use(rows: slice, flat: IntArray, changes: FloatArray) -> None:
            sums = self._base.rows(rows)
            changes[:, 1:] += sums[:, :1] * common
            if self._near:
                # The weights themselves change only if alpha is automatic.
                changes += self._slope * found["alpha"] * self._near.rows(rows)
            x = bound.points[flat] - self._fit.origin
            moved = finish_tangents(bound.rotation, sums, x, changes, bound.repeats, self._transition, rest)
            if turn is not None:
                moved = moved @ turn.T + self._seen(sums, flat) @ found["turn"].T
            moved_rows[flat] = moved + found.get("shift", 0.0)

        moved_rows = Nodes.of(out).rows
        _push(self._sums, values, use, weigh=False)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        bound, turn, k = self._bound, self._turned(), len(self._fit.values)
        # For every portion: gradients of shift, turn, rest, alpha, and of the value common to sources at rest.
        parts = np.zeros((self._sums.portions, 3 + 9 + 6 + 1 + k))
        # With a transition, the last sum is the total weight of the moving sources, which never changes.
        changing = k - 1 if self._transition.width > 0.0 else k

        def make(places: slice, flat: IntArray, portion: int) -> FloatArray:
            g, sums, part = rows[flat], self._base.rows(places), parts[portion]
            part[:3] += g.sum(axis=0)
            if turn is not None:
                part[3:12] += (g.T @ self._seen(sums, flat)).ravel()
                g = g @ turn
            x = bound.points[flat] - self._fit.origin
            found, rest = finish_gradients(bound.rotation, sums, x, g, bound.repeats, self._transition)
            part[12:18] += rest
            if self._near:
                part[18] += self._slope * np.einsum("nk,nk->", found, self._near.rows(places))
            part[19:] += sums[:, 0] @ found[:, 1:]
            return found[:, 1 : 1 + changing]

        acting, rows = self._sums.acting, Nodes.of(gradient).rows
        values = np.zeros((k, np.count_nonzero(acting)))
        own = self._sums.transpose(make, changing)[:, acting]
        values[:changing] = bound.grid.nodes.total(own)
        part = bound.grid.nodes.total(parts.sum(axis=0))
        if not acting.all():
            values = np.append(values, (part[19:] - values.sum(axis=1))[:, None], axis=1)
        known = {
            "values": values, "shift": part[:3], "turn": part[3:12].reshape(3, 3),
            "rest": part[12:18], "alpha": part[18],
        }  # fmt: skip
        given = {number: known[name] for name, number in self._numbers.items()}
        return self._tape.pull(given, [self._variable])[0]


def _apart(values: FloatArray, acting: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Values (k, n) of all sources relative to those at rest, and the latter (k,): the last of reduced ``values``."""
    common = np.zeros(len(values)) if acting.all() else values[:, -1]
    found = np.zeros((len(values), len(acting)))
    found[:, acting] = values[:, : np.count_nonzero(acting)] - common[:, None]
    return found, common


def _accurate(
    bound: Bound, weights: Weights, values: FloatArray, acting: BoolArray, fast: bool, transition: bool
) -> tuple[Sums, _AtNodes]:
    """Fast sums, refined until their error at the nodes where they are compared with exact ones is small enough; exact
    sums if it remains too large."""
    share = _FIRST_SHARE
    for _ in range(1 + MAX_RETRIES if fast else 0):
        sums = fast_sums(bound, weights, acting, share)
        found = _AtNodes(bound.grid, sums, values, transition)
        # All ranks must decide alike, also those whose processors round otherwise.
        error = agreed(bound.grid.nodes.ranks, found.error(bound, sums, weights, values))
        if error <= DERIVATIVE_TOLERANCE:
            return sums, found
        if not np.isfinite(error):
            break
        share *= 0.9 * DERIVATIVE_TOLERANCE / error
    exact = ExactSums(bound, weights, acting)
    return exact, _AtNodes(bound.grid, exact, values, transition)


def _push(sums: Sums, values: FloatArray, use: Use, weigh: bool = True) -> None:
    """Sums of values as they are, exact or fast."""
    if isinstance(sums, FastSums):
        sums.apply(Scaled.plain(values), use, weigh)
    else:
        sums.apply(values, use, weigh)


class _AtNodes:
    """Sums (n, 1 + k) of the values at the nodes, stored as total weights and means.

    Weights, including those of moving sources alone, are in double precision, as their difference is taken; for the
    means of fast sums single precision suffices.
    """

    def __init__(self, grid: Grid, sums: Sums, values: FloatArray, transition: bool) -> None:
        values, common = _apart(values, sums.acting)
        lasting = 1 if transition else 0
        self._weight = empty((len(sums.flat), 1 + lasting))
        self._means = empty(
            (len(sums.flat), len(values) - lasting), np.float32 if isinstance(sums, FastSums) else np.float64
        )
        self._k = 1 + len(values)

        def keep(rows: slice, flat: IntArray, found: FloatArray) -> None:
            found[:, 1:] += found[:, :1] * common
            self._weight[rows, 0], self._weight[rows, -1] = found[:, 0], found[:, -1] if transition else found[:, 0]
            self._means[rows] = found[:, 1 : self._k - lasting] / found[:, :1]

        _push(sums, values, keep)

    def error(self, bound: Bound, sums: FastSums, weights: Weights, values: FloatArray) -> float:
        """Largest error of a sum of unit values relative to the total weight, at the nodes with the largest error
        bounds and at random ones; infinite if any sum is not finite."""
        if not np.isfinite(self._weight).all():
            return np.inf
        own, common = _apart(values, sums.acting)
        rows = np.unique(doubtful(bound.grid.points, sums.targets.numbered, sums.risk))
        exact = ExactSums(bound, weights).at(sums.flat[rows], np.vstack([own, sums.acting]), chunk=_CHECKED)
        exact /= bound.strength.max()
        exact, acting = exact[:, :-1], exact[:, -1]
        found = self.rows(rows)
        found[:, 1:] -= found[:, :1] * common
        gap = np.abs(found - exact) / exact[:, :1]
        # An error of the total weight matters in proportion to the weight of the acting sources.
        gap[:, 0] *= acting / exact[:, 0]
        # Means are stored in single precision.
        size = np.append(1.0, np.abs(own).max(axis=1) + np.abs(common))
        return float(np.max(gap[:, size > 0.0] / size[size > 0.0], initial=0.0))

    def rows(self, rows: slice | IntArray) -> FloatArray:
        """The sums (m, 1 + k) of some rows."""
        weight, means = self._weight[rows], self._means[rows]
        found = np.empty((len(weight), self._k))
        found[:, 0], found[:, -1] = weight[:, 0], weight[:, -1]
        np.multiply(means, weight[:, :1], out=found[:, 1 : 1 + means.shape[1]])
        return found
