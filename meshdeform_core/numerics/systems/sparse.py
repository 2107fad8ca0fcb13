"""Matrices of compact radial basis functions whose support contains few centres."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from ..arrays import FloatArray
from ..exact.basis import BASES, apply_basis

_MOST_NEIGHBOURS = 500
_LARGEST_SHARE = 0.05
# Work space for a nonzero value, and for all of them.
_BYTES, _MOST_BYTES = 64, 2**32


def sparse_radial_matrix(kind: int, points: FloatArray, require: Callable[[int], object]) -> Any:
    """The matrix (n, n) of a compact basis without its zeros, in CSR format, or ``None`` if that does not pay.

    It pays when centres have on average at most 500 neighbours, at most a twentieth of all centres, and when the work
    space is at most 4 GiB (a fixed limit, so that results do not depend on the memory available). ``require(bytes)`` is
    called with the memory needed.

    Parameters
    ----------
    kind : basis number, see :data:`.basis.BASES`
    points : (n, 3) centres in units of the support radius
    """
    if kind == BASES["tps"]:
        return None
    tree, n = scipy.spatial.cKDTree(points), len(points)
    count = int(tree.count_neighbors(tree, 1.0))
    if count > n * min(_MOST_NEIGHBOURS, _LARGEST_SHARE * n) or _BYTES * count > _MOST_BYTES:
        return None
    require(_BYTES * count)
    pairs = tree.query_pairs(1.0, output_type="ndarray")
    values = np.append(((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2).sum(axis=1), 0.0)
    apply_basis(kind, values, len(values))
    lower, upper, diagonal = pairs[:, 0], pairs[:, 1], np.arange(n)
    rows = np.concatenate([lower, upper, diagonal])
    columns = np.concatenate([upper, lower, diagonal])
    entries = np.concatenate([values[:-1], values[:-1], np.full(n, values[-1])])
    return scipy.sparse.coo_array((entries, (rows, columns)), shape=(n, n)).tocsr()
