"""Started by test_mpi.py under mpiexec: ``USMesh`` on all ranks, whose pieces together equal those of one process."""

import sys

import numpy as np
from api.test_idwarp import bend
from mpi4py import MPI
from solver_stub import Solver

from meshdeform.compat.idwarp import USMesh


def a_solver(comm, path):
    """The calls of a solver: with three ranks the last one has nothing."""
    solver, mesh = Solver.of(path, comm.rank, comm.size), USMesh({"gridFile": path}, comm)
    assert bool(len(solver.indices)) == (comm.rank < 2)
    solver.set_mesh(mesh)
    moved = bend(solver.points)
    mesh.setSurfaceCoordinates(moved)
    mesh.warpMesh()
    grid = mesh.getSolverGrid().reshape(-1, 3)
    np.testing.assert_array_equal(grid[solver.wall_of], moved)
    weights, change = np.cos(7.0 * solver.start).ravel(), np.sin(5.0 * solver.points)
    mesh.warpDeriv(weights)
    gradient, pushed = mesh.getdXs(), mesh.warpDerivFwd(change)
    assert gradient.shape == solver.points.shape
    # One process alone, which holds all pieces, for each rank.
    whole, alone = Solver.of(path), USMesh({"gridFile": path}, MPI.COMM_SELF)
    whole.set_mesh(alone)
    alone.setSurfaceCoordinates(bend(whole.points))
    alone.warpMesh()
    by_node = dict(zip((whole.indices[::3] // 3).tolist(), alone.getSolverGrid().reshape(-1, 3), strict=True))
    np.testing.assert_array_equal(grid, [by_node[n] for n in (solver.indices[::3] // 3).tolist()] or grid)
    alone.warpDeriv(np.cos(7.0 * whole.start).ravel())
    total = comm.allreduce((gradient * np.sin(3.0 * solver.points)).sum())
    np.testing.assert_allclose(total, (alone.getdXs() * np.sin(3.0 * whole.points)).sum(), rtol=1e-10)
    one, two = comm.allreduce(float(weights @ pushed.ravel())), comm.allreduce(float((gradient * change).sum()))
    assert abs(one - two) < 1e-11 * abs(one)


if __name__ == "__main__":
    world = MPI.COMM_WORLD
    a_solver(world, sys.argv[1])
    print(f"rank {world.rank} of {world.size} agrees")
