"""Methods on grids of one layer of cells between two planes that mirror each other, see :mod:`..boundary.layer`."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from ..boundary.layer import Layer
from ..grid import FloatArray
from .base import Account, Linearised, PreparedMethod, Problem, Progress
from .composite import Composite, on_faces
from .constraints import put_on_faces


class PreparedLayer(PreparedMethod):
    """A method prepared on one of two planes that mirror each other; for other motions, on both."""

    def __init__(self, method: Composite, problem: Problem, layer: Layer):
        self._method, self._problem, self._layer = method, problem, layer
        self._half = method.prepare(dataclasses.replace(problem, layer=layer))

    @cached_property
    def whole(self) -> PreparedMethod:
        """The method prepared on both planes, when it is needed for the first time."""
        return self._method.prepare(self._problem)

    @property
    def account(self) -> Account:
        return self._half.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self._half.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        problem = self._problem
        known = np.zeros((problem.topology.n_unique, 3))
        if displacement.shape == (len(problem.source_numbers), 3):
            known[problem.source_numbers] = displacement
        if not self._layer.mirrors(known):
            return self.whole.apply(displacement, progress)
        out = self._half.apply(displacement, progress)
        face = on_faces(out, problem)
        self._layer.follow(face)
        put_on_faces(face, out, problem)
        return out

    def linearised(self, displacement: FloatArray) -> Linearised:
        # On both planes, as changes of single sources are not mirrored.
        return self.whole.linearised(displacement)
