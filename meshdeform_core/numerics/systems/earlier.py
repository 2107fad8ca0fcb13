"""Right-hand sides solved before, from which the starting guess for the next one is made.

Fischer, Projection techniques for iterative solution of Ax = b with successive right-hand sides, Comput. Methods Appl.
Mech. Engrg. 163 (1998): the images of earlier solutions are kept orthonormal, so that the nearest combination
is a projection. Every component is a right-hand side of its own: the coordinates of a turning body, for instance, are
three functions, whatever its angle.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

# Weight of a use relative to a use one right-hand side later.
_FADING = 0.7


class EarlierSolutions:
    """Solutions (c, p) of one system and their images ``A c + P p``.

    Parameters
    ----------
    n, terms : number of centres and of polynomial terms
    capacity : how many of them (single components) are kept; those least used by recent right-hand sides are dropped
    """

    def __init__(self, n: int, terms: int, capacity: int) -> None:
        self._n, self._terms, self.capacity = n, terms, capacity
        self.clear()

    def __len__(self) -> int:
        return self._images.shape[1]

    def clear(self) -> None:
        """Forget everything."""
        self._images = np.empty((self._n, 0), order="F")
        self._solutions = np.empty((self._n + self._terms, 0), order="F")
        self._used = np.empty(0)

    def nearest(self, right: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, m) and polynomial (q, m) of the combinations whose images are nearest to ``right`` (n, m).

        Nothing promises that they are near, or that their images are exactly what they were taken for: the residual
        has to be computed.
        """
        part = self._images.T @ right
        self._used = _FADING * self._used + (part**2).sum(axis=1)
        found = self._solutions @ part
        return found[: self._n], found[self._n :]

    def add(self, coefficients: FloatArray, polynomial: FloatArray, images: FloatArray, least: float) -> None:
        """Keep the part of the solutions (columns, images of about unit norm) that is new by more than ``least``."""
        solutions = np.concatenate([coefficients, polynomial])
        for column in range(images.shape[1]):
            self._add(solutions[:, column], images[:, column], least)

    def _add(self, solution: FloatArray, image: FloatArray, least: float) -> None:
        if not self.capacity:
            return
        # A second pass removes what round-off left after the first.
        for _ in range(2):
            part = self._images.T @ image
            image, solution = image - self._images @ part, solution - self._solutions @ part
        size = np.linalg.norm(image)
        if size <= least:
            return
        # The images of the remaining solutions are still orthonormal.
        kept = np.sort(np.argsort(-self._used, kind="stable")[: self.capacity - 1])
        self._images = np.column_stack([self._images[:, kept], image / size])
        self._solutions = np.column_stack([self._solutions[:, kept], solution / size])
        self._used = np.append(self._used[kept], size**2)
