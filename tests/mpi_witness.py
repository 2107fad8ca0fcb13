"""Ranks that make what is forbidden fail: see the rules in meshdeform_core/parallel/loops.py."""

import ctypes
import faulthandler
import mmap
import random
import time

import numpy as np

from meshdeform_core.parallel import loops as parallel
from meshdeform_core.parallel.mpi import CommonMemory, MPIRanks


class Witness(MPIRanks):
    """Counts rows and makes what is forbidden fail.

    ``own`` are the rows that this rank fills, ``every`` those that all of them fill. Common memory is write-protected
    but in the loops that fill it, so that any other write kills the rank; and ranks dawdle where they might meet.
    """

    own = every = mapped = 0

    def __init__(self, world, machines=1):
        faulthandler.enable()
        # Grids of tests are small: every array counts as large.
        parallel._SMALL = 0
        super().__init__(world, machines)

    def share(self, array, rows):
        sizes = [sum(len(part) for part in rows(number)) for number in range(self.count)]
        self.own += sizes[self.number]
        self.every += sum(sizes)
        super().share(array, rows)

    def empty(self, shape, dtype):
        array = super().empty(shape, dtype)
        self._protect([array], mmap.PROT_READ)
        return array

    def begin(self, arrays):
        super().begin(arrays)
        self._protect(arrays, mmap.PROT_READ | mmap.PROT_WRITE)
        self._dawdle(arrays)

    def finish(self, arrays):
        self._protect(arrays, mmap.PROT_READ)
        super().finish(arrays)
        self._dawdle(arrays)

    @staticmethod
    def _dawdle(arrays):
        if arrays and random.random() < 0.3:
            time.sleep(0.0005)

    def _protect(self, arrays, how):
        for array in arrays:
            while isinstance(array, np.ndarray):
                array = array.base
            if isinstance(array, CommonMemory):
                self.mapped += 1
                address = ctypes.addressof(ctypes.c_char.from_buffer(array))
                assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(address), ctypes.c_size_t(len(array)), how) == 0
