"""Started by test_mpi.py under mpiexec: every method on all ranks together against the same on one alone.

With the argument ``compile`` every method runs on this process alone.
"""

import itertools
import sys

import numpy as np
from cases import ALL_METHODS, body_specs, problem_of, turning
from grids import frame, frame_2d
from mpi4py import MPI

from meshdeform_core.boundary.prescribed import prescribed_displacement
from meshdeform_core.methods import IDW, RBF, Options, make_method
from meshdeform_core.parallel import OneRank, set_ranks
from meshdeform_core.parallel.mpi import MPIRanks
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.verdict.validity import newly_invalid

FAST = {
    "idw-fast": Options("idw", idw=IDW(summation="fast")),
    "rbf-fast": Options("rbf", rbf=RBF(summation="fast")),
    "rbf-greedy": Options("rbf", rbf=RBF(basis="wendland-c2", radius=6.0, greedy="hybrid")),
}


# One global and one compact basis stand for the others, which share every loop with them.
CHOSEN = {name: options for name, options in ALL_METHODS.items() if "ctps" not in name}

DIFFERENTIATED = ("idw-rbf", "idw-fast", "rbf-fast", "rbf-greedy")


class Counting(MPIRanks):
    """Counts rows: ``own`` are those that this rank fills, ``every`` those that all of them fill."""

    own = every = 0

    def share(self, array, rows):
        sizes = [sum(len(part) for part in rows(number)) for number in range(self.count)]
        self.own += sizes[self.number]
        self.every += sum(sizes)
        super().share(array, rows)


def results(options, problem):
    """Displacement, quality and invalid cells: everything that ranks share."""
    told = prescribed_displacement(problem.grid, problem.topology, problem.boundary)[problem.source_numbers]
    moved = make_method(options).prepare(problem).apply(told)
    after = problem.grid.points + moved
    original = Original(problem.grid, problem.topology)
    verdict = assess(original, after, problem.boundary)
    return moved, verdict, newly_invalid(original, after)


def derivatives(options, problem):
    """Changes and gradients: the derivatives of one displacement, forward and transposed."""
    told = prescribed_displacement(problem.grid, problem.topology, problem.boundary)[problem.source_numbers]
    found = make_method(options).prepare(problem).linearised(told)
    weight = np.sin(np.arange(3.0 * problem.grid.n_nodes)).reshape(-1, 3)
    return found.push(told[:, [2, 0, 1]]), found.pull(weight.copy())


def every_case():
    turn = body_specs(turning(60))
    return CHOSEN | FAST, [problem_of(frame(7, 5), turn), problem_of(frame_2d(9), turn[:1])]


def main():
    ranks = Counting(MPI.COMM_WORLD)
    methods, problems = every_case()
    broken = 0
    for name, options in methods.items():
        for problem in problems:
            set_ranks(OneRank())
            alone = results(options, problem)
            set_ranks(ranks)
            shared = results(options, problem)
            np.testing.assert_array_equal(shared[0], alone[0], err_msg=name)
            assert shared[1] == alone[1], name
            np.testing.assert_array_equal(shared[2], alone[2], err_msg=name)
            broken += len(alone[2])
            if name in DIFFERENTIATED:
                slopes = derivatives(options, problem)
                set_ranks(OneRank())
                for one, two in zip(slopes, derivatives(options, problem), strict=True):
                    np.testing.assert_array_equal(one, two, err_msg=name)
    assert broken, "no method broke a cell: the lists of invalid cells were compared empty"
    # Loops with fewer chunks than ranks leave some of them idle on grids as small as these.
    part = ranks.own * ranks.count / ranks.every
    assert 0.4 < part < 2.0, f"rank {ranks.number} did {part:.0%} of its share"
    print(f"rank {ranks.number} of {ranks.count} agrees")


if "compile" in sys.argv:
    for each, case in itertools.product(*every_case()):
        results(CHOSEN.get(each) or FAST[each], case)
        if each in DIFFERENTIATED:
            derivatives(FAST.get(each) or CHOSEN[each], case)
else:
    main()
