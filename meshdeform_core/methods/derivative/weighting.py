"""Derivative of inverse distance weighting: rigid motions of the sources, their sums, and the motion of the nodes."""

from __future__ import annotations

import numpy as np

from ...errors import MethodError
from ...grid import FloatArray, IntArray
from ...numerics.exact.direct import weighted_sums
from ...numerics.rigid import finish
from ...numerics.tangents import finish_gradients, finish_tangents
from ...numerics.tape import Tape, Tracked, plain
from ...parallel import for_chunks
from ..scattered.idw import PreparedIDW
from ..scattered.idw_sums import Bound
from ..scattered.tuned import ALPHA_CAP

_LEAST_ALPHA = 1e-3
_CHUNK = 4096


class IDWDerivative:
    """Derivative of the displacement of the nodes ``bound.flat`` at one displacement (n_sources, 3) of the sources.

    The rotations, their smoothing and the mean motion are differentiated as they are computed; sums over sources are
    exact sums of derivatives, and their transposes exact sums over nodes.
    """

    def __init__(self, method: PreparedIDW, bound: Bound, displacement: FloatArray) -> None:
        if bound.reweight:
            raise MethodError(
                "method.idw.reweight has no derivative: its weights depend on the displacement of the nodes; "
                "use reweight = false"
            )
        self._bound, self._tape = bound, Tape()
        variable = self._tape.variable(displacement)
        self._variable = variable.number
        fit = method.fit(variable)  # type: ignore[arg-type]
        self._fit, self._values = fit, plain(fit.values)
        self._transition = fit.transition._replace(rest=plain(fit.transition.rest))
        self._alpha, self._slope = self._automatic_alpha(method, variable)
        wanted = {
            "values": fit.values, "shift": fit.frame.shift, "turn": fit.frame.turn,
            "rest": fit.transition.rest, "alpha": self._alpha,
        }  # fmt: skip
        self._numbers = {name: each.number for name, each in wanted.items() if isinstance(each, Tracked)}
        self._x = bound.grid.points[bound.flat] - fit.origin
        self._sums = self._summed(self._values, fit.weights)
        self._sums_near = self._summed(self._values, self._near) if self._slope else None

    @property
    def flat(self) -> IntArray:
        """The nodes that it moves."""
        return self._bound.flat

    @property
    def _near(self) -> tuple[tuple[float, float, float], ...]:
        """The part of the weights that alpha multiplies."""
        return tuple((b, 5.0, 0.0) for _, b, _ in self._fit.weights)

    def _automatic_alpha(self, method: PreparedIDW, variable: Tracked) -> tuple[Tracked | None, float]:
        """Alpha by eq. 18, and the derivative of the factor of r^-b; none where alpha is given or at its limits."""
        o = method.options
        if o.weights != "luke" or o.alpha != "auto":
            return None, 0.0
        d = method._images.displaced(variable)  # type: ignore[arg-type]
        frame = method._frame(d)
        inside = d if frame.turn is None else frame.relative(method._images.points, d)
        arm = inside - (method.area / method.area.sum()) @ inside
        largest = int(np.argmax(np.linalg.norm(plain(arm), axis=1)))
        alpha: Tracked = o.eta / method.length * np.linalg.norm(arm[largest])  # type: ignore[assignment]
        value = float(plain(alpha))
        if not _LEAST_ALPHA < value < ALPHA_CAP:
            return None, 0.0
        return alpha, o.b * value ** (o.b - 1.0) * method.length ** (o.b - method.far)

    def _summed(self, values: FloatArray, weights: tuple[tuple[float, float, float], ...]) -> FloatArray:
        """Sums (n, 1 + k) over all sources at all nodes."""
        bound, total = self._bound, np.zeros((len(self._x), 1 + len(values)))
        for group, weight in zip(bound.groups, weights, strict=True):
            near = self._fit.path[0][group], bound.strength[group]
            total += weighted_sums(self._x, *near, weight, values[:, group])
        return total

    def _spread(self, gradient: FloatArray) -> FloatArray:
        """The transpose: gradients (k, n_sources) from those (n, k) of the sums of values."""
        bound = self._bound
        total = np.zeros((gradient.shape[1], len(bound.sources)))
        ones = np.ones(len(self._x))
        for group, weight in zip(bound.groups, self._fit.weights, strict=True):
            found = weighted_sums(self._fit.path[0][group], self._x, ones, weight, np.ascontiguousarray(gradient.T))
            total[:, group] = bound.strength[group] * found[:, 1:].T
        return total

    def _turned(self) -> FloatArray | None:
        turn = self._fit.frame.turn
        return None if turn is None else plain(turn)

    def _seen(self, rows: slice) -> FloatArray:
        """Positions relative to the centre of the mean rotation, moved within the frame."""
        assert self._fit.frame.centre is not None
        bound, moved = self._bound, np.empty_like(self._x[rows])
        finish(bound.rotation, self._sums[rows], self._x[rows], moved, bound.repeats, self._transition)
        return np.asarray(moved + bound.grid.points[bound.flat[rows]] - self._fit.frame.centre)

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for one of the sources."""
        found = dict(
            zip(self._numbers, self._tape.push(self._variable, change, list(self._numbers.values())), strict=True)
        )
        changes = self._summed(found["values"], self._fit.weights)
        # The weights themselves change with an automatic alpha only.
        changes[:, 0] = 0.0
        if self._sums_near is not None:
            changes += self._slope * found["alpha"] * self._sums_near
        bound, turn, rest = self._bound, self._turned(), found.get("rest", np.zeros(6))

        def work(lo: int, hi: int) -> None:
            rows = slice(lo, hi)
            moved = finish_tangents(
                bound.rotation, self._sums[rows], self._x[rows], changes[rows], bound.repeats, self._transition, rest
            )
            if turn is not None:
                moved = moved @ turn.T + self._seen(rows) @ found["turn"].T
            out[bound.flat[rows]] = moved + found.get("shift", 0.0)

        for_chunks(work, len(self._x), _CHUNK)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        bound, turn = self._bound, self._turned()
        parts: dict[int, tuple[FloatArray, FloatArray]] = {}
        sums = np.empty_like(self._sums)

        def work(lo: int, hi: int) -> None:
            rows = slice(lo, hi)
            g = gradient[bound.flat[rows]]
            turning = np.zeros((3, 3))
            if turn is not None:
                turning, g = g.T @ self._seen(rows), g @ turn
            sums[rows], rest = finish_gradients(
                bound.rotation, self._sums[rows], self._x[rows], g, bound.repeats, self._transition
            )
            parts[lo] = turning, rest

        for_chunks(work, len(self._x), _CHUNK)
        known = {"values": self._spread(sums[:, 1:]), "shift": gradient[bound.flat].sum(axis=0)}
        known["turn"] = sum((parts[lo][0] for lo in sorted(parts)), np.zeros((3, 3)))
        known["rest"] = sum((parts[lo][1] for lo in sorted(parts)), np.zeros(6))
        if self._sums_near is not None:
            known["alpha"] = np.asarray(self._slope * np.einsum("nk,nk->", sums, self._sums_near))
        return self._tape.pull(self._variable, {number: known[name] for name, number in self._numbers.items()})
