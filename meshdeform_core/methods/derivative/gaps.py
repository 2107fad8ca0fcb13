"""Derivative of a composite that is replaced by TFI in closing gaps."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from ..composite import _on_faces
from ..gaps import Closing, PreparedInGaps
from .composite import Derivative, derivative_of_composite
from .constraints import Constraints


class InGapsDerivative:
    """Derivative of the blend of the method with TFI, including that of the share of TFI."""

    def __init__(self, method: PreparedInGaps, closing: Closing, displacement: FloatArray) -> None:
        self._closing, self._share = closing, method.spread(closing.share)
        inside = (self._share > 0.0) & (self._share < 1.0)
        own = method.method.apply(displacement)
        apart = method.transfinite.apply(displacement) - own
        self._apart = inside * apart
        self._own: Derivative = derivative_of_composite(method.method, displacement)
        self._lines: Derivative = derivative_of_composite(method.transfinite, displacement)
        self._scalar: Derivative = derivative_of_composite(method.scalar, displacement)
        self.kinks = self._own.kinks + self._lines.kinks
        # Blended nodes are projected back onto curved slip surfaces.
        self._problem, self._again = method._problem, None
        if self._problem.boundary.slip.curved:
            blend = own + self._share * apart
            self._again = Constraints(self._problem, _on_faces(blend, self._problem))
            self.kinks += self._again.kinks

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for a ``change`` (n_sources, 3) of the sources."""
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
            self._again.impose(_on_faces(out, self._problem), out)
        return out

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that (n_nodes, 3) of all block nodes, which is overwritten."""
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
