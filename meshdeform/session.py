"""The ranks, threads and moving nodes of a mesh, and the turns that calls of the library take."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.boundary.classification import given_displacement
from meshdeform_core.deform import Setup
from meshdeform_core.errors import GridError, MotionError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.parallel import Ranks, sharing

from .grid import checked_array, in_parts

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

# Re-entrant, as a thread may call again, for example from a function that returns displacements.
_lock = threading.RLock()


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Wait for calls of other threads to end: each sets the threads and ranks of all loops of the process."""
    with _lock:
        yield


def _renew() -> None:
    """Make a new lock in a forked process, where the thread that held the old one does not exist."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)


def ranks_of_comm(comm: Comm | None) -> Ranks:
    """The ranks of a communicator; this process alone without one."""
    if comm is None:
        return Ranks()
    from meshdeform_core.parallel.mpi import MPIRanks

    return MPIRanks(comm)


class Session:
    """What a mesh shares with its derivatives and with the interfaces of other programs.

    Parameters
    ----------
    plane : whether users give and get two coordinates
    ranks, threads : that share the work of every call; this call is one of them

    Attributes
    ----------
    numbers : unique numbers of the independently moving nodes, ascending; their periodic partners follow them
    points : undeformed positions (n_moving, 3) of these nodes; read-only
    """

    def __init__(self, setup: Setup, plane: bool, ranks: Ranks, threads: int | None):
        self.setup, self.plane, self.ranks, self.threads = setup, plane, ranks, threads
        self._thread = threading.get_ident()
        movers = [nodes for nodes, _ in setup.boundary.movers]
        self.numbers: IntArray = np.unique(np.concatenate(movers)).astype(np.int64)
        self.points: FloatArray = setup.grid.points[setup.topology.first[self.numbers]]
        self.points.flags.writeable = False

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Context of a call: one at a time, with threads and ranks of the mesh; a mesh in parts keeps to its thread."""
        if self.ranks.count > 1 and threading.get_ident() != self._thread:
            raise GridError("a mesh prepared with comm= is used in another thread; expected the one that prepared it")
        with in_parts(), one_at_a_time(), sharing(self.ranks, self.threads):
            yield

    def checked(self, values: Any, what: str, rows: int) -> FloatArray:
        """An array (rows, 3); (rows, 2) is accepted for a grid given in the plane, any other array refused."""
        every = rows == len(self.points)
        meaning = "one row per node of mesh.points" if every else "one row per node of the patch"
        if self.plane and np.ndim(values) == 2 and np.shape(values)[1] == 2:
            return np.pad(checked_array(values, (rows, 2), what, meaning, MotionError), ((0, 0), (0, 1)))
        return checked_array(values, (rows, 3), what, meaning, MotionError)

    def of_boundary(self, values: FloatArray) -> FloatArray:
        """Displacement (n_unique, 3) of all nodes on faces from that (n_moving, 3) of the moving ones.

        Refused where a 2-D grid would leave its plane, or periodic images would move differently.
        """
        setup = self.setup
        return given_displacement(setup.grid, setup.topology, setup.boundary, self.numbers, values)


def share_of(count: int, ranks: Ranks) -> slice:
    """The rows of this rank when ``count`` rows are divided evenly: those of rank r begin at int(count r / ranks)."""
    return slice(count * ranks.number // ranks.count, count * (ranks.number + 1) // ranks.count)


def gathered(ranks: Ranks, piece: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The rows of all ranks, in the order of the ranks."""
    return np.array(ranks.collect(piece, ranks.gather([len(piece)])))


def summed(ranks: Ranks, count: int, rows: IntArray, values: FloatArray) -> FloatArray:
    """Sum (count, 3) of the ``values`` (n, 3) of all ranks for ``rows`` (n,), which may repeat."""
    total = np.zeros((count, 3))
    np.add.at(total, gathered(ranks, rows), gathered(ranks, values))
    return total
