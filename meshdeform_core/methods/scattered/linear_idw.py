"""Derivative of inverse distance weighting: rigid motions of the sources, their sums, and the motion of the nodes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.fastsum.weighted import Accuracy, FastSums
from ...numerics.tape import Tape, Tracked, plain
from ...parallel import Nodes, empty
from .idw_sums import CHECKED, ExactSums, SourceValues, Weights, sums_of_groups
from .summation import DERIVATIVE_TOLERANCE, MAX_RETRIES, doubtful

_FIRST_SHARE = 1.7
"""Initial error allowed to one cluster, as a multiple of that allowed to the sum; sufficient on the hemispheres, while
the plates need half of it."""
_ORDER = 5
"""Interpolation points per side of a cluster; among 4 to 7, the fastest on the hemisphere."""
_PER_POINT = 4
"""Nodes of a brick per interpolation point; twice as many, as the method itself has, take a quarter longer."""
_RECORDED = 1024
"""Nodes whose motion is recorded at a time, which bounds the memory."""

Sums = ExactSums | FastSums


class LinearIDW:
    """Derivative of the displacement of the targets of a method at one displacement (n_sources, 3) of the sources.

    Sums over sources become sums of derivatives, exact or fast like those of the method, and their transposes are sums
    over nodes. ``fit`` of the sources that move, and of one of the others, was recorded from the displacement
    ``variable``; ``acting`` (n,) are the images of sources that move, ``alpha`` is that of eq. 16 if it depends on the
    displacement, and ``slope`` the derivative of the factor of r^-b with respect to it.
    """

    def __init__(
        self, method: Any, variable: Tracked, fit: SourceValues, acting: BoolArray,
        alpha: Tracked | None, slope: float,
    ) -> None:  # fmt: skip
        self._method, self._variable, self._slope = method, variable, slope
        frame, rest = fit.frame, fit.transition.rest
        # What every node depends on beside its own sums.
        common: dict[str, Any] = {"shift": frame.shift, "turn": frame.turn, "rest": rest}
        self._common: dict[str, Tracked] = {name: each for name, each in common.items() if isinstance(each, Tracked)}
        own: dict[str, Any] = {"values": fit.values} if alpha is None else {"values": fit.values, "alpha": alpha}
        self._tracked: dict[str, Tracked] = self._common | own
        self._transition = fit.transition._replace(rest=plain(rest))
        self._fit = dataclasses.replace(
            fit,
            frame=dataclasses.replace(frame, shift=plain(frame.shift), turn=plain(frame.turn)),
            transition=self._transition,
        )
        kept = plain(fit.values), acting, self._transition.width > 0.0
        self._sums, self._base = _accurate(method, fit.weights, *kept)
        self._near = None
        if slope:
            # The part of the weights that alpha multiplies.
            near = tuple((b, 5.0, 0.0) for _, b, _ in fit.weights)
            _, self._near = _accurate(method, near, *kept)

    def _recorded(self, flat: IntArray, sums: FloatArray) -> tuple[Tracked, list[Tracked], dict[str, Tracked]]:
        """Displacement of some nodes, recorded from the columns of their sums and from what they have in common."""
        tape, fit = Tape(), self._fit
        columns = [tape.variable(column) for column in sums.T]
        common = {name: tape.variable(plain(each)) for name, each in self._common.items()}
        frame = {name: each for name, each in common.items() if name != "rest"}
        fit = dataclasses.replace(
            fit,
            frame=dataclasses.replace(fit.frame, **frame),  # type: ignore[arg-type]
            transition=self._transition._replace(rest=common.get("rest", self._transition.rest)),  # type: ignore[arg-type]
        )
        found: Tracked = self._method.displacement(fit, flat, columns)
        return found, columns, common

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        numbers = [each.number for each in self._tracked.values()]
        given = self._variable.tape.push({self._variable.number: change}, numbers)
        found, moved = dict(zip(self._tracked, given, strict=True)), Nodes.of(out).rows
        values, at_rest = _apart(found["values"], self._sums.acting)

        def use_tangents(rows: slice, flat: IntArray, changes: FloatArray) -> None:
            sums = self._base.rows(rows)
            changes[:, 1:] += sums[:, :1] * at_rest
            if self._near:
                # The weights themselves change only if alpha is automatic.
                changes += self._slope * found["alpha"] * self._near.rows(rows)
            for lo in range(0, len(flat), _RECORDED):
                some = slice(lo, lo + _RECORDED)
                result, columns, common = self._recorded(flat[some], sums[some])
                told = {each.number: column for each, column in zip(columns, changes[some].T, strict=True)}
                told |= {each.number: found[name] for name, each in common.items()}
                moved[flat[some]] = result.tape.push(told, [result.number])[0]

        self._sums.apply(values, use_tangents, weigh=False)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        k, rows = len(self._fit.values), Nodes.of(gradient).rows
        # For every portion: gradients of what the nodes have in common, and of the values common to sources at rest.
        sizes = {name: each.shape for name, each in self._common.items()} | {"alpha": (), "at rest": (k,)}
        parts = {name: np.zeros((self._sums.portions, *size)) for name, size in sizes.items()}
        # With a transition, the last sum is the total weight of the moving sources, which never changes.
        changing = k - 1 if self._transition.width > 0.0 else k

        def make(places: slice, flat: IntArray, portion: int) -> FloatArray:
            sums = self._base.rows(places)
            of_sums = np.empty_like(sums)
            for lo in range(0, len(flat), _RECORDED):
                some = slice(lo, lo + _RECORDED)
                result, columns, common = self._recorded(flat[some], sums[some])
                wanted = [each.number for each in (*columns, *common.values())]
                found = result.tape.pull({result.number: rows[flat[some]]}, wanted)
                of_sums[some] = np.stack(found[: k + 1], axis=1)
                for name, each in zip(common, found[k + 1 :], strict=True):
                    parts[name][portion] += each
            if self._near:
                parts["alpha"][portion] += self._slope * np.einsum("nk,nk->", of_sums, self._near.rows(places))
            parts["at rest"][portion] += sums[:, 0] @ of_sums[:, 1:]
            return of_sums[:, 1 : 1 + changing]

        acting, total = self._sums.acting, self._method.problem.grid.nodes.total
        values = np.zeros((k, np.count_nonzero(acting)))
        own = self._sums.transpose(make, changing)[:, acting]
        values[:changing] = total(own)
        known = {name: total(part.sum(axis=0)) for name, part in parts.items()}
        if not acting.all():
            values = np.append(values, (known["at rest"] - values.sum(axis=1))[:, None], axis=1)
        known["values"] = values
        given = {each.number: known[name] for name, each in self._tracked.items()}
        return self._variable.tape.pull(given, [self._variable.number])[0]


def _apart(values: FloatArray, acting: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Values (k, n) of all sources relative to those at rest, and the latter (k,): the last of reduced ``values``."""
    common = np.zeros(len(values)) if acting.all() else values[:, -1]
    found = np.zeros((len(values), len(acting)))
    found[:, acting] = values[:, : np.count_nonzero(acting)] - common[:, None]
    return found, common


def _accurate(
    method: Any, weights: Weights, values: FloatArray, acting: BoolArray, transition: bool
) -> tuple[Sums, _AtNodes]:
    """Fast sums, refined until their error at the nodes where they are compared with exact ones is small enough; exact
    sums if it remains too large."""
    share = _FIRST_SHARE
    for _ in range(1 + MAX_RETRIES if method.fast else 0):
        sums = _fast_sums(method, weights, acting, share)
        found = _AtNodes(sums, values, transition)
        # All ranks must decide alike, also those whose processors round otherwise.
        error = method.problem.grid.nodes.ranks.largest(found.error(method, sums, weights, values))
        if error <= DERIVATIVE_TOLERANCE:
            return sums, found
        if not np.isfinite(error):
            break
        share *= 0.9 * DERIVATIVE_TOLERANCE / error
    exact = ExactSums(method, weights, acting)
    return exact, _AtNodes(exact, values, transition)


def _fast_sums(method: Any, weights: Weights, acting: BoolArray, share: float) -> FastSums:
    """Sums whose accuracy is relative to the largest change of a value, whatever the displacement; each cluster is
    allowed the error ``share``, relative to that allowed to the sum."""
    # Clusters of acting sources alone, as few sources act.
    parts = [
        (some, each)
        for group, each in zip(method.groups, weights, strict=True)
        for some in (group[acting[group]], group[~acting[group]])
        if some.size
    ]
    found = sums_of_groups(method, [group for group, _ in parts], _ORDER, 2 * method.flat.nbytes, _PER_POINT)
    # Bounds are rounded up to powers of four: that of one half is one.
    shift, turn = np.where(acting, 0.5, 0.0), np.zeros(len(acting))
    accuracy = Accuracy(DERIVATIVE_TOLERANCE * share, False, False)
    found.prepare([each for _, each in parts], shift, turn, acting, accuracy)
    return found


class _AtNodes:
    """Sums (n, 1 + k) of the values at the nodes, stored as total weights and means.

    Weights, including those of moving sources alone, are in double precision, as their difference is taken; for the
    means of fast sums single precision suffices.
    """

    def __init__(self, sums: Sums, values: FloatArray, transition: bool) -> None:
        values, common = _apart(values, sums.acting)
        lasting = 1 if transition else 0
        self._weight = empty((len(sums.flat), 1 + lasting))
        self._means = empty(
            (len(sums.flat), len(values) - lasting), np.float32 if isinstance(sums, FastSums) else np.float64
        )
        self._k = 1 + len(values)

        def keep_sums(rows: slice, flat: IntArray, found: FloatArray) -> None:
            found[:, 1:] += found[:, :1] * common
            self._weight[rows, 0], self._weight[rows, -1] = found[:, 0], found[:, -1] if transition else found[:, 0]
            self._means[rows] = found[:, 1 : self._k - lasting] / found[:, :1]

        sums.apply(values, keep_sums)

    def error(self, method: Any, sums: FastSums, weights: Weights, values: FloatArray) -> float:
        """Largest error of a sum of unit values relative to the total weight, at the nodes with the largest error
        bounds and at random ones; infinite if any sum is not finite."""
        if not np.isfinite(self._weight).all():
            return np.inf
        own, common = _apart(values, sums.acting)
        order = np.argsort(sums.flat)
        flat = np.unique(doubtful(method.problem.grid.points, sums.targets, sums.risk))
        rows = order[np.searchsorted(sums.flat, flat, sorter=order)]
        exact = ExactSums(method, weights).at(sums.flat[rows], np.vstack([own, sums.acting]), chunk=CHECKED)
        exact /= method.strength.max()
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
