"""Started by test_mpi.py under mpiexec: a mesh of which every rank holds its part, against the whole mesh."""

import sys

import numpy as np
from mpi4py import MPI

import meshdeform as md

PATTERNS = ["block2.imax", "block4.jmax", "block5.jmin", "block7.imin"]


def motion(points, time):
    return 0.2 * points[:, [1, 0, 2]] * [1.0, 1.0, 0.0]


def main(comm, path):
    one, own = (md.prepare(path, moving=PATTERNS, slip=["*.kmin", "*.kmax"], **rest) for rest in ({}, {"comm": comm}))
    np.testing.assert_array_equal(own.points, one.points)
    at, ours = (mesh.linearise(motion, repair="off") for mesh in (one, own))
    change, gradient = np.cos(5.0 * one.points), [np.sin(9.0 * block) for block in at.step.grid.blocks]
    whole = at.step.grid.blocks, at.jvp(change), at.step.quality_gradient("f_skew_min").blocks
    mine = [part.points for part in ours.step.grid.part], ours.jvp(change)
    mine += (ours.step.quality_gradient("f_skew_min").blocks,)
    for every, found in zip(whole, mine, strict=True):
        for place, values in zip(ours.step.grid.part, found, strict=True):
            np.testing.assert_array_equal(values, every[place.block][place.first : place.last])
    swept = at.step.swept_volumes(one.grid)
    for place, faces in zip(ours.step.grid.part, ours.step.swept_volumes(own.grid), strict=True):
        for found, every in zip(faces, swept[place.block], strict=True):
            np.testing.assert_array_equal(found, every[place.first : place.last])
    pulled = ours.vjp([gradient[place.block][place.first : place.last] for place in ours.step.grid.part])
    expected = at.vjp(gradient)
    np.testing.assert_allclose(pulled, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    assert comm.allreduce(sum(len(place.points) for place in ours.step.grid.part)) == sum(map(len, one.grid.blocks))
    sys.stdout.write(f"rank {comm.rank} of {comm.size} agrees\n")


if __name__ == "__main__":
    main(MPI.COMM_WORLD, sys.argv[1])
