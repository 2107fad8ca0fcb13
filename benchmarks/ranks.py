"""Strong scaling over ranks: the splitter plate by IDW, one thread per rank.

    mpiexec -n 2 python benchmarks/ranks.py 24 fast     # or: exact, or: idw-tfi

One start measures 1, 2, 4, ... ranks one after the other. For every stage it prints the wall seconds, and the largest
CPU seconds that a rank computed in it: on a shared machine the wall time says little, the CPU time is what
the stage takes when every rank has a core of its own, without the exchange.
"""

import sys
import time
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI

from meshdeform_core.deform import set_up
from meshdeform_core.methods import make_method
from meshdeform_core.parallel import for_rows, set_ranks, set_threads
from meshdeform_core.parallel.mpi import MPIRanks
from meshdeform_core.quality import Original, assess
from meshdeform_formats.case import read_case
from meshdeform_samples import folder, load

WORLD = MPI.COMM_WORLD
METHODS = {
    "exact": ("idw", ("method.idw.summation=exact",)),
    "fast": ("idw", ("method.idw.summation=fast",)),
    "idw-tfi": ("idw-tfi", ()),
}


class TimedRanks(MPIRanks):
    """Separates the time a rank computes from the time it spends waiting and exchanging data."""

    idle = 0.0

    @contextmanager
    def _counted(self, sign):
        start = time.process_time()
        yield
        self.idle += sign * (time.process_time() - start)

    def begin(self, arrays):
        with self._counted(1):
            super().begin(arrays)

    def share(self, array, rows):
        with self._counted(1):
            super().share(array, rows)

    def finish(self, arrays):
        with self._counted(1):
            super().finish(arrays)

    def empty(self, shape, dtype):
        with self._counted(1):
            return super().empty(shape, dtype)

    def once(self, make):
        def worked():
            with self._counted(-1):
                return make()

        with self._counted(1):
            return super().once(worked)


def main(size, kind):
    set_threads(1)
    method, overrides = METHODS[kind]
    case = read_case(folder("splitter-plate") / "case.toml", overrides, method).case
    if WORLD.rank == 0:
        print(f"splitter plate n = {size}, {kind}: wall s / largest CPU s per rank")
    counts = [2**n for n in range(WORLD.size.bit_length()) if 2**n <= WORLD.size]
    # The first round compiles and touches the memory.
    first = measure(8, case, WORLD.size)
    assert first or WORLD.rank
    for count in counts:
        found = measure(size, case, count)
        if WORLD.rank == 0:
            columns = "  ".join(f"{name} {wall:.2f} / {cpu:.2f}" for name, (wall, cpu) in found.items())
            print(f"{count} ranks  {columns}", flush=True)


def measure(size, case, count):
    """Seconds (wall, largest CPU) of each stage on the first ``count`` ranks, known to the first one."""
    group = WORLD.Split(0 if WORLD.rank < count else MPI.UNDEFINED)
    found = _stages(TimedRanks(group), size, case) if group != MPI.COMM_NULL else {}
    done = WORLD.Ibarrier()
    while not done.Test():
        # Sleep, so that idle ranks leave the cores to the others.
        time.sleep(0.01)
    return found


def _stages(ranks, size, case):
    group, found = ranks._comm, {}
    set_ranks(ranks)
    grid = load("splitter-plate").generate(size)

    @contextmanager
    def stage(name):
        group.Barrier()
        wall, cpu, idle = time.perf_counter(), time.process_time(), ranks.idle
        yield
        busy = time.process_time() - cpu - (ranks.idle - idle)
        group.Barrier()
        found[name] = time.perf_counter() - wall, group.allreduce(busy, MPI.MAX)

    with stage("topology"):
        setup = set_up(grid, case)
    with stage("prepare"):
        prepared = make_method(case.method).prepare(setup.problem)
    displacement = setup.displacement(0.0)[setup.problem.source_numbers]
    with stage("apply"):
        after = prepared.apply(displacement)
        for_rows(lambda rows: np.add(grid.points[rows], after[rows], out=after[rows]), after)
    with stage("quality"):
        assess(Original(grid, setup.topology), after, setup.boundary)
    return found


main(int(sys.argv[1]), sys.argv[2])
