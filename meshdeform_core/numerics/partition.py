"""Partial sorting: the members with the smaller keys first, in no particular order otherwise."""

from .jit import inlined


@inlined
def partition(members, key, first, last, middle):
    """Reorder ``first`` to ``last`` so that the smallest keys come before ``middle`` (quickselect)."""
    lo, hi = first, last
    while lo < hi:
        pivot = key[(lo + hi) // 2]
        i, j = lo, hi
        while i <= j:
            while key[i] < pivot:
                i += 1
            while key[j] > pivot:
                j -= 1
            if i <= j:
                key[i], key[j] = key[j], key[i]
                members[i], members[j] = members[j], members[i]
                i += 1
                j -= 1
        if middle <= j:
            hi = j
        elif middle >= i:
            lo = i
        else:
            lo = hi
