"""Which points coincide: exact copies first, then pairs closer than the smaller of their own tolerances.

Plain numpy (``meshdeform info`` must start fast and imports no numba).
"""

import numpy as np

# A direction that no grid line is aligned with: projected on it, distinct nodes hardly ever share a key.
_GENERIC = np.array([0.5403023058681398, 0.6427876096865393, 0.5446390350150271])


def _key(points):
    # Not a matrix product: equal points must get equal keys, whatever order a BLAS sums in.
    return points[:, 0] * _GENERIC[0] + points[:, 1] * _GENERIC[1] + points[:, 2] * _GENERIC[2]


def coincident_groups(points, tolerance):
    """Number points so that coincident ones share a number.

    Two points coincide when their distance is at most the *smaller* of their tolerances; coincidence is transitive.

    Parameters
    ----------
    points : (n, 3) float64
    tolerance : (n,) float64, grid length unit

    Returns
    -------
    labels : (n,) int64 in ``0 ... n_groups - 1``, numbered by first occurrence
    """
    order = np.argsort(_key(points), kind="stable")
    ordered = points[order]
    copy_of = np.cumsum(np.r_[False, (ordered[1:] != ordered[:-1]).any(axis=1)])
    first = np.r_[0, np.flatnonzero(np.diff(copy_of)) + 1]
    pairs = close_pairs(ordered[first], np.maximum.reduceat(tolerance[order], first))
    exact = np.empty(len(points), dtype=np.int64)
    exact[order] = copy_of
    return _by_first_occurrence(_components(len(first), pairs)[exact])


def close_pairs(points, tolerance):
    """All pairs of points closer than the smaller of their tolerances, ``(m, 2)`` int64.

    A sweep along one direction, from the coarsest tolerance to the finest: the points within one tolerance of a
    plane are few if only points of at least that tolerance take part, however strongly the grid is clustered.
    """
    key = _key(points)
    order = np.argsort(key, kind="stable")
    key, points, tolerance = key[order], points[order], tolerance[order]
    level = np.frexp(tolerance)[1]
    found = []
    for current in np.unique(level)[::-1]:
        members = np.flatnonzero(level >= current)
        keys, reach = key[members], np.ldexp(1.0, int(current))
        active = np.arange(len(members) - 1)
        shift = 1
        while active.size:
            active = active[active + shift < len(members)]
            active = active[keys[active + shift] - keys[active] <= reach]
            a, b = members[active], members[active + shift]
            near = (np.minimum(level[a], level[b]) == current) & _within(points, tolerance, a, b)
            found.append(np.stack([a[near], b[near]], axis=1))
            shift += 1
    pairs = np.concatenate(found) if found else np.empty((0, 2), dtype=np.int64)
    return order[pairs]


def _within(points, tolerance, a, b):
    gap = np.linalg.norm(points[a] - points[b], axis=1)
    return gap <= np.minimum(tolerance[a], tolerance[b])


def _components(n, pairs):
    """Smallest member of each connected component, by label propagation with pointer jumping."""
    labels = np.arange(n)
    while len(pairs):
        low = np.minimum(labels[pairs[:, 0]], labels[pairs[:, 1]])
        before = labels.copy()
        np.minimum.at(labels, pairs[:, 0], low)
        np.minimum.at(labels, pairs[:, 1], low)
        labels = labels[labels]
        if np.array_equal(labels, before):
            break
    return labels


def _by_first_occurrence(labels):
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]


def equal_rows(rows):
    """Partner of each row of a small-integer table: the other row that is equal to it.

    Parameters
    ----------
    rows : (n, m) int64, non-negative, m in (2, 4), each row sorted

    Returns
    -------
    partner : (n,) int64, ``-1`` where no other row is equal; in groups of more than two the rows point in a ring
    count : (n,) int64, size of each row's group
    """
    if rows.shape[1] == 4:
        keys = (rows[:, 2] << 32 | rows[:, 3], rows[:, 0] << 32 | rows[:, 1])
    else:
        keys = (rows[:, 1], rows[:, 0])
    order = np.lexsort(keys)
    ordered = rows[order]
    start = np.flatnonzero(np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)])
    size = np.diff(np.r_[start, len(rows)])
    count = np.empty(len(rows), dtype=np.int64)
    count[order] = np.repeat(size, size)
    following = np.arange(1, len(rows) + 1)
    following[start + size - 1] = start
    partner = np.empty(len(rows), dtype=np.int64)
    partner[order] = order[following]
    return np.where(count > 1, partner, -1), count


def distinct(numbers, size):
    """The different ones of ``numbers`` (any shape, integers in 0 ... size - 1), ascending, int64.

    By marks instead of sorting or hashing, as there are few numbers to choose from.
    """
    marked = np.zeros(size, dtype=bool)
    marked[numbers] = True
    return np.flatnonzero(marked)
