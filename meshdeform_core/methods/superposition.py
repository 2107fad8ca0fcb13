"""Displacements that are combinations of earlier ones are combined instead of computed.

A mode times a function of time spans one dimension; for methods that treat the components alike, a rigid motion of any
angle spans four (the coordinates of the body and a constant).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..grid import FloatArray
from ..numerics.rows import add_transformed_rows
from ..parallel import current_ranks, empty, for_rows
from .base import Account, PreparedMethod, Problem, Progress, Setting

_MOST_LEVELS = 6
# Part of the memory left for methods that stored fields may take.
_SHARE = 0.25
# What may be left of a displacement, relative to its largest value, and relative to the coordinates, whose round-off
# displacements inherit.
_REMAINDER, _ROUND_OFF = 1e-12, 1e-15
_RANK = 1e-9
# Errors of the stored fields add up to at most so many times theirs.
_LARGEST_SUM = 2.0
_PATIENCE = 12


@dataclasses.dataclass(frozen=True)
class _Field:
    """Displacement (n_sources, 3) of the sources and the resulting field (n_nodes, 3)."""

    sources: FloatArray
    nodes: FloatArray


class Superposition:
    """A prepared method that stores computed fields and combines them where the result is the same.

    A displacement of the sources that is a combination of stored ones, to round-off and with coefficients whose sum is
    at most 2, gives the same combination of the stored fields; so the error of solvers and fast sums is at most twice
    that of computing it. All others are computed and stored. Results depend on earlier displacements only within that
    error.

    Parameters
    ----------
    method : computes the fields
    problem : the undeformed grid; its memory limits the number of stored fields, possibly to none
    """

    def __init__(self, method: PreparedMethod, problem: Problem):
        self._method, self._problem = method, problem
        self._capacity = int(min(_MOST_LEVELS, _SHARE * problem.memory.size // problem.grid.points.nbytes))
        boundary = problem.boundary
        # Slip planes and rotated periodic pairs treat the components differently: combine only whole displacements.
        self._columns = 1 if boundary.slip.planes or boundary.mirrors or boundary.periodic.one.size else 3
        self._size = float(np.abs(problem.source_points).max())
        self._misses = 0
        self._combined: Setting | None = None
        self.clear()

    def clear(self) -> None:
        """Forget all fields."""
        self._fields: list[_Field] = []
        self._basis: tuple[FloatArray, FloatArray] | None = None

    @property
    def account(self) -> Account:
        """Report of the method, and whether the last field was computed or combined."""
        account = Account()
        account.include(self._method.account)
        if self._combined:
            account.settings["combined_from"] = self._combined
            if "iterations" in account.settings:
                account.settings["iterations"] = Setting(0, "combined from fields of earlier levels")
        return account

    @property
    def linear(self) -> bool:
        """Always."""
        return True

    @property
    def cheap(self) -> bool:
        """Whether the method is."""
        return self._method.cheap

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self._method.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        share = current_ranks().on_first(lambda: self._shares(displacement))
        self._combined = None
        if share is not None:
            self._misses = 0
            self._combined = Setting(len(self._fields), "fields of earlier levels, of which this one is a combination")
            return self._combination(share)
        found = self._method.apply(displacement, progress)
        self._misses += 1
        if self._misses > _PATIENCE:
            # This motion does not repeat itself.
            self._capacity = 0
            self.clear()
        self._store(displacement, found)
        return found

    def _shares(self, displacement: FloatArray) -> FloatArray | None:
        """Coefficients (fields, 3, 3) that give ``displacement`` from the stored ones; ``None`` if there are none."""
        if self._basis is None:
            return None
        left, back = self._basis
        wanted = displacement.reshape(len(left), -1)
        part = left.T @ wanted
        allowed = _REMAINDER * np.abs(displacement).max() + _ROUND_OFF * self._size
        share = back @ part
        found = np.abs(wanted - left @ part).max() <= allowed
        if not found or np.abs(share).sum(axis=0).max() > _LARGEST_SUM:
            return None
        if self._columns == 3:
            return share.reshape(-1, 3, 3)
        return share.reshape(-1, 1, 1) * np.eye(3)

    def _combination(self, share: FloatArray) -> FloatArray:
        out: FloatArray = empty(self._problem.grid.points.shape)

        def fill(rows: slice) -> None:
            out[rows] = 0.0
            for field, each in zip(self._fields, share, strict=True):
                add_transformed_rows(field.nodes[rows], each, out[rows])

        for_rows(fill, out)
        return out

    def _store(self, displacement: FloatArray, found: FloatArray) -> None:
        if not self._capacity or not displacement.any():
            return
        if len(self._fields) < self._capacity:
            # Solving for the field may have taken what was meant for it.
            left = current_ranks().on_first(lambda: self._problem.memory.left)
            self._capacity = min(self._capacity, len(self._fields) + max(left, 0) // found.nbytes)
            if not self._capacity:
                return
        del self._fields[: max(0, len(self._fields) + 1 - self._capacity)]
        nodes: FloatArray = empty(found.shape)
        for_rows(lambda rows: np.copyto(nodes[rows], found[rows]), nodes)
        self._fields = self._needed([_Field(displacement.copy(), nodes), *reversed(self._fields)])
        self._basis = _factors([self._columns_of(field) for field in self._fields])

    def _columns_of(self, field: _Field) -> FloatArray:
        return field.sources if self._columns == 3 else field.sources.reshape(-1, 1)

    def _needed(self, fields: list[_Field]) -> list[_Field]:
        """From fields, newest first, those that are not combinations of newer ones; returned oldest first."""
        kept: list[_Field] = []
        basis = np.empty((len(self._columns_of(fields[0])), 0))
        for field in fields:
            columns = self._columns_of(field)
            rest = columns - basis @ (basis.T @ columns)
            left, spread, _ = np.linalg.svd(rest, full_matrices=False)
            new = spread > _RANK * np.linalg.norm(columns)
            if new.any():
                kept.insert(0, field)
                basis = np.concatenate([basis, left[:, new]], axis=1)
        return kept


def _factors(stored: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis of the stored columns, and the map from its coefficients to those of the stored columns."""
    columns = np.concatenate(stored, axis=1)
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    left, spread, right = np.linalg.svd(columns / size, full_matrices=False)
    kept = spread > _RANK * spread[0]
    return left[:, kept], (right[kept] / size).T / spread[kept]


def remembering(method: PreparedMethod, problem: Problem) -> PreparedMethod:
    """The method wrapped in a :class:`Superposition` if it is linear and that saves time; else the method itself."""
    return Superposition(method, problem) if method.linear and not method.cheap else method
