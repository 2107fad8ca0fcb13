"""Ranks that take turns in one process: what one of them leaves to the others is still missing when it is done."""

from contextlib import contextmanager

import numpy as np

from meshdeform_core.parallel import OneRank, set_ranks
from meshdeform_core.parallel import loops as parallel

UNTOUCHED = 77


class Pretended(OneRank):
    """Rank ``number`` of ``count``; ``arrays`` are those in common memory, in the order in which they are made."""

    private = ""

    def __init__(self, number, count, arrays):
        super().__init__(cores=1)
        self.number, self.count, self.on_machine = number, count, count
        self._arrays, self._made = arrays, 0

    def empty(self, shape, dtype):
        if self._made == len(self._arrays):
            self._arrays.append(np.full(shape, UNTOUCHED, dtype))
        self._made += 1
        return self._arrays[self._made - 1]


@contextmanager
def rank(number, count, arrays, small=0):
    """Be one of several ranks for a while; arrays of ``small`` bytes or more, by default all, count as large."""
    before, parallel._SMALL = parallel._SMALL, small
    set_ranks(Pretended(number, count, arrays))
    try:
        yield
    finally:
        set_ranks(OneRank())
        parallel._SMALL = before
