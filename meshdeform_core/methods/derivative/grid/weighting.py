"""Derivative of inverse distance weighting with respect to displacements and to the grid.

Sources and nodes move, and with them areas, normals, the reference length and the breadth of the moving surface; with
``reweight`` they also move from one division of the rotation to the next. Sums are exact ones of all pairs, whatever
the method uses. Held fixed is what changes nothing: the origin of twists, and the unit of areas, of which weights and
the ``crossing`` of the transition are multiples.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from ....grid import FloatArray, IntArray
from ....numerics.arrays import lengths
from ....numerics.exact.direct_tangents import add_gradients, add_tangents
from ....numerics.frame import Frame
from ....numerics.rigid import finish
from ....numerics.rotation import SurfaceRotations
from ....numerics.tangents import finish_gradients, finish_tangents
from ....numerics.tape import Tape, Tracked, plain
from ....parallel import Shared, empty, for_chunks
from ...base import nodal_area
from ...scattered.idw import PreparedIDW, farthest
from ...scattered.idw_sums import Bound, ExactEvaluator, SourceValues
from ...scattered.transition import breadth, with_motion
from ..kinks import FARTHEST, Kinks, kinks_of, tied
from ..weighting import automatic_alpha, idw_kinks

_CHUNK = 2048
_PORTIONS = 32


class IDWGridDerivative:
    """Derivative of the displacement of the nodes of an evaluator, with exact sums, at one displacement (n_sources, 3)
    of the sources; ``kinks`` as for :class:`..composite.Derivative`, ``of_grid`` those that only changes of the grid
    meet."""

    def __init__(self, method: PreparedIDW, bound: Bound, displacement: FloatArray) -> None:
        self._problem, self._bound, self._tape = method._problem, bound, Tape()
        given = displacement, self._problem.source_points, self._problem.centroid
        variables = [self._tape.variable(each) for each in given]
        self._variables = [each.number for each in variables]
        moving = _on_moving_sources(method, variables[1], variables[2])
        fit = moving.fit(variables[0])  # type: ignore[arg-type]
        self._fit = _values_of(fit)
        kappa, strength = _kappa(moving, variables[0]), moving.strength
        charges: Any = np.concatenate([strength.reshape(1, -1), strength * fit.values])
        wanted: dict[str | int, Any] = {
            "charges": charges, "kappa": kappa, "shift": fit.frame.shift, "turn": fit.frame.turn,
            "centre": fit.frame.centre, "rest": fit.transition.rest, **dict(enumerate(fit.path)),
        }  # fmt: skip
        self._share = 0.0
        if fit.transition.width > 0.0 and method._share and method._share.near != method._share.power:
            # The crossing depends on the breadth, by a power law.
            wanted["breadth"] = found = breadth(moving._images)
            self._share = method._share.near / float(plain(found))
        self.kinks = idw_kinks(method, fit, displacement)
        self.of_grid = self._farthest(method)
        self._numbers = {name: each.number for name, each in wanted.items() if isinstance(each, Tracked)}
        self._charges, path = np.ascontiguousarray(plain(charges)), self._fit.path
        self._path = [np.ascontiguousarray(sources.T) for sources in path]
        self._portions = max(1, min(_PORTIONS // len(path), len(bound.flat) // _CHUNK))

    def _farthest(self, method: PreparedIDW) -> Kinks:
        """Sources that share the largest distance from a centre."""
        problem, images, counts = self._problem, method._images, list[tuple[str, int]]()
        if method.options.length == "auto" and (method.options.weights == "luke" or len(method.groups) > 1):
            size = lengths(problem.source_points - problem.centroid)
            counts.append((FARTHEST.replace("{what}", "L_def of eq. 16"), tied(size, np.arange(len(size)))))
        if self._share:
            moving = with_motion(images)
            area, x = images.area[moving], images.points[moving]
            size = lengths(x - area @ x / area.sum())
            counts.append((FARTHEST.replace("{what}", "the breadth of the body"), tied(size, images.owner[moving])))
        return kinks_of(counts)

    def push(self, change: FloatArray, dx: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for changes of the sources
        (n_sources, 3) and of the grid (n_nodes, 3)."""
        topology, bound = self._problem.topology, self._bound
        mean = dx.sum(axis=0) - dx[topology.face_nodes].sum(axis=0) + dx[topology.first].sum(axis=0)
        given = change, dx[self._problem.source_flat], mean / self._problem.n_unique_nodes
        changes = dict(zip(self._variables, given, strict=True))
        found = dict(zip(self._numbers, self._tape.push(changes, list(self._numbers.values())), strict=True))
        frame = self._fit.frame

        def work(lo: int, hi: int) -> None:
            flat = bound.flat[lo:hi]
            x, own = bound.grid.points[flat], dx[flat]
            total, moved = self._push_rows(x - self._fit.origin, own, found)
            if frame.turn is not None and frame.centre is not None:
                seen, apart = total + x - frame.centre, own - found["centre"]
                moved = moved @ frame.turn.T + seen @ found["turn"].T + apart @ (frame.turn - np.eye(3)).T
            out[flat] = moved + found.get("shift", 0.0)

        for_chunks(work, len(bound.flat), _CHUNK, shared=[Shared(out, lambda lo, hi: bound.flat[lo:hi])])

    def _push_rows(
        self, x: FloatArray, dx: FloatArray, found: dict[str | int, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Displacement (n, 3) of nodes at ``x``, relative to the origin, within the frame, and its change."""
        bound, total, moved = self._bound, np.zeros_like(x), np.zeros_like(x)
        charges, rest = np.ascontiguousarray(found["charges"]), found.get("rest", np.zeros(6))
        for place, sources in enumerate(self._path):
            here, own = x + total, dx + moved
            dy = np.ascontiguousarray(found[place].T) if place in found else np.zeros_like(sources)
            sums, change = np.zeros((len(x), len(charges))), np.zeros((len(x), len(charges)))
            for group, (a, b, kappa) in zip(bound.groups, self._fit.weights, strict=True):
                ends = here, own, sources[:, group], dy[:, group], self._charges[:, group], charges[:, group]
                add_tangents(*ends, a, b, kappa, float(found.get("kappa", 0.0)), sums, change)
            change += self._share * float(found.get("breadth", 0.0)) * sums
            kind, inside = (bound.rotation, sums, here), (bound.repeats, self._fit.transition)
            total += self._moved(*kind)
            moved += finish_tangents(*kind, change, *inside, rest) + np.einsum("nij,nj->ni", self._slope(*kind), own)
        return total, moved

    def pull(self, gradient: FloatArray, of_grid: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3); adds that of the grid."""
        bound, frame = self._bound, self._fit.frame
        columns, n = self._charges.shape
        cut = np.linspace(0, len(bound.flat), self._portions + 1).astype(np.int64)
        # For every portion: gradients of charges and path; of turn, centre, rest, kappa and breadth.
        of_sources = empty((self._portions, columns + 3 * len(self._path), n))
        rest = np.zeros((self._portions, 9 + 3 + 6 + 1 + 1))
        of_x = empty((len(bound.flat), 3))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                of_sources[portion] = 0.0
                for first in range(cut[portion], cut[portion + 1], _CHUNK):
                    rows = slice(first, min(first + _CHUNK, int(cut[portion + 1])))
                    of_x[rows] = self._pull_rows(gradient, bound.flat[rows], of_sources[portion], rest[portion])

        rows = [Shared(of_sources), Shared(rest), Shared(of_x, lambda lo, hi: range(cut[lo], cut[hi]))]
        for_chunks(work, self._portions, 1, shared=rows)
        part = rest.sum(axis=0)
        sources = np.asarray(sum(of_sources[portion] for portion in range(self._portions)))
        path = sources[columns:].reshape(-1, 3, n).transpose(0, 2, 1)
        known: dict[str | int, FloatArray] = {
            "charges": sources[:columns], "shift": gradient[bound.flat].sum(axis=0),
            "turn": part[:9].reshape(3, 3), "centre": part[9:12], "rest": part[12:18], "kappa": part[18],
            "breadth": part[19], **dict(enumerate(path)),
        }  # fmt: skip
        assert frame.turn is None or "centre" in self._numbers
        given = {number: known[name] for name, number in self._numbers.items()}
        of_change, of_points, of_centroid = self._tape.pull(given, self._variables)
        of_grid[bound.flat] += of_x
        topology, mean = self._problem.topology, of_centroid / self._problem.n_unique_nodes
        of_grid += mean
        of_grid[topology.face_nodes] -= mean
        of_grid[topology.first] += mean
        of_grid[self._problem.source_flat] += of_points
        return of_change

    def _pull_rows(self, gradient: FloatArray, flat: IntArray, of_sources: FloatArray, rest: FloatArray) -> FloatArray:
        """Gradients of the positions of some nodes; adds to those of sources and of what is common to all."""
        fit, frame, points = self._fit, self._fit.frame, self._bound.grid.points[flat]
        g, here, of_x = gradient[flat], points - fit.origin, np.zeros_like(points)
        course = []
        for sources in fit.path:
            sums = ExactEvaluator(self._bound)._sums(fit, here, sources)
            course.append((sums, here))
            here = here + self._moved(self._bound.rotation, sums, here)
        if frame.turn is not None and frame.centre is not None:
            rest[:9] += (g.T @ (here + fit.origin - frame.centre)).ravel()
            of_x += g @ (frame.turn - np.eye(3))
            rest[9:12] -= of_x.sum(axis=0)
            g = g @ frame.turn
        for place in reversed(range(len(course))):
            back = self._pull_division(place, *course[place], g, of_sources, rest)
            of_x += back
            g = g + back
        return of_x

    def _pull_division(
        self, place: int, sums: FloatArray, x: FloatArray, g: FloatArray, of_sources: FloatArray, rest: FloatArray
    ) -> FloatArray:
        """Gradients of the positions of nodes at ``x`` in one division of the rotation, from those of their
        displacement in it."""
        bound, fit, columns = self._bound, self._fit, len(self._charges)
        kind = bound.rotation, sums, x
        of_x = np.einsum("nij,ni->nj", self._slope(*kind), g)
        of_sums, of_rest = finish_gradients(*kind, g, bound.repeats, fit.transition)
        rest[12:18] += of_rest
        rest[19] += self._share * np.einsum("nk,nk->", of_sums, sums)
        own = slice(columns + 3 * place, columns + 3 * place + 3)
        for group, (a, b, kappa) in zip(bound.groups, fit.weights, strict=True):
            some = self._path[place][:, group], self._charges[:, group]
            of_y, of_charges = np.zeros((3, len(group))), np.zeros((columns, len(group)))
            rest[18] += add_gradients(x, *some, a, b, kappa, of_sums, of_x, of_y, of_charges)
            of_sources[:columns, group] += of_charges
            of_sources[own, group] += of_y
        return of_x

    def _moved(self, kind: str, sums: FloatArray, x: FloatArray) -> FloatArray:
        """Displacement (n, 3), within the frame, of nodes at ``x``, which is relative to the origin."""
        moved = np.empty_like(x)
        finish(kind, sums, x, moved, self._bound.repeats, self._fit.transition)
        return moved

    def _slope(self, kind: str, sums: FloatArray, x: FloatArray) -> FloatArray:
        """Derivative (n, 3, 3) of :meth:`_moved` with respect to ``x`` for fixed sums: all motions are affine in x."""
        base = self._moved(kind, sums, np.zeros_like(x))
        columns = [self._moved(kind, sums, np.tile(e, (len(x), 1))) - base for e in np.eye(3)]
        return np.stack(columns, axis=2)


class IDWOnFixedGrid:
    """Derivative at a fixed grid, for weights that are recomputed in every step of a division."""

    def __init__(self, method: PreparedIDW, bound: Bound, displacement: FloatArray) -> None:
        self._whole = IDWGridDerivative(method, bound, displacement)
        self._shape = bound.grid.points.shape
        self.kinks = self._whole.kinks

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        self._whole.push(change, np.broadcast_to(0.0, self._shape), out)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        return self._whole.pull(gradient, np.zeros(self._shape))


def _values_of(fit: SourceValues) -> SourceValues:
    """The recorded values as plain arrays."""
    frame, transition = fit.frame, fit.transition
    return dataclasses.replace(
        fit,
        path=tuple(plain(each) for each in fit.path),
        values=plain(fit.values),
        transition=transition._replace(rest=plain(transition.rest)),
        frame=Frame(plain(frame.shift), plain(frame.turn), plain(frame.centre)),
    )


def _on_moving_sources(method: PreparedIDW, points: Tracked, centroid: Tracked) -> PreparedIDW:
    """The method with recorded positions of sources and of the centroid of all nodes."""
    images, problem, o = method._images, method._problem, method.options
    fixed = images.points - np.einsum("nij,nj->ni", images.reflection, problem.source_points[images.owner])
    moved: Any = np.einsum("nij,nj->ni", images.reflection, points[images.owner]) + fixed
    # The area of a node on a mirror plane includes that of the other side.
    before = problem.surface.area[images.owner]
    sides = np.divide(images.area, before, out=np.ones_like(before), where=before > 0.0)
    area: Any = nodal_area(points, problem.source_faces)[images.owner] * sides  # type: ignore[arg-type]
    found = copy.copy(method)
    found._images = dataclasses.replace(images, points=moved, area=area)
    found.area, found.points = area, moved
    found._rotations = SurfaceRotations(moved, images.corners, images.edges, problem.plane_normal)
    if o.length == "auto":
        found.length = farthest(points, centroid)  # type: ignore[assignment, arg-type]
    found.strength = _strength(method, area, found.length)
    return found


def _strength(method: PreparedIDW, area: Any, length: Any) -> Any:
    """Strengths of the sources as in :class:`PreparedIDW`, in its units."""
    o = method.options
    if o.weights == "luke":
        return area * (1.0 / method.area.max())
    if len(method.groups) == 1:
        return method.strength
    return np.where(method._images.moving, length**o.p_moving, length**o.p_fixed)


def _kappa(method: PreparedIDW, displacement: Tracked) -> Any:
    """The factor of r^-b, tracked if it depends on points or displacement."""
    o = method.options
    if o.weights != "luke":
        return 0.0
    alpha: Any = automatic_alpha(method, displacement)
    if alpha is None:
        alpha = _plain_alpha(method, displacement)
    return alpha**o.b * method.length ** (o.b - method.far)


def _plain_alpha(method: PreparedIDW, displacement: Tracked) -> float:
    """Alpha where it does not depend on the displacement: prescribed, or at one of its limits."""
    o = method.options
    return method._alpha(plain(displacement)) if o.alpha == "auto" else float(o.alpha)
