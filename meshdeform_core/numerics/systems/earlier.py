"""Right-hand sides that were solved before, as a start for the next one.

Fischer, Projection techniques for iterative solution of Ax = b with successive right-hand sides, Comput. Methods Appl.
Mech. Engrg. 163 (1998): what earlier solutions are known to give is kept orthonormal, so that the nearest combination
is a projection. Every component is a right-hand side of its own: the coordinates of a turning body, for instance, are
three functions, whatever its angle.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

# How much an earlier use counts beside one a right-hand side later.
_FADING = 0.7


class EarlierSolutions:
    """Solutions (c, p) of one system and their images ``A c + P p``.

    Parameters
    ----------
    n, terms : number of centres and of polynomial terms
    capacity : how many of them, single components, are kept; those that recent right-hand sides used least give way
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
        """Keep solutions, columns of about unit image, in as far as they are new: by more than ``least``."""
        solutions = np.concatenate([coefficients, polynomial])
        for column in range(images.shape[1]):
            self._add(solutions[:, column], images[:, column], least)

    def _add(self, solution: FloatArray, image: FloatArray, least: float) -> None:
        if not self.capacity:
            return
        # Once more for what round-off left of the first time.
        for _ in range(2):
            part = self._images.T @ image
            image, solution = image - self._images @ part, solution - self._solutions @ part
        size = np.linalg.norm(image)
        if size <= least:
            return
        # The images of what stays are orthonormal still.
        kept = np.sort(np.argsort(-self._used, kind="stable")[: self.capacity - 1])
        self._images = np.column_stack([self._images[:, kept], image / size])
        self._solutions = np.column_stack([self._solutions[:, kept], solution / size])
        self._used = np.append(self._used[kept], size**2)
