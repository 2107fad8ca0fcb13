"""A coupled solver in full: the displacement of a wall goes in, a judged grid comes out, time step by time step.

Run it with ``python examples/coupling.py FOLDER`` or, sharing the work among processes, ``mpiexec -n 2 python
examples/coupling.py FOLDER --mpi``. The solver is a stand-in that bends the wing of the sample case.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import meshdeform as md

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


def solver(points: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Displacement (n, 3) of the wall at ``time``: bending that grows with the square of the span."""
    displacement = np.zeros_like(points)
    displacement[:, 2] = 0.1 * np.sin(2 * np.pi * time) * points[:, 1] ** 2
    return displacement


def main(folder: Path, comm: Comm | None = None) -> list[md.Step]:
    """Deform the sample wing at three times and write the last grid."""
    wing = md.sample("wing", "small")
    mesh = md.prepare(
        wing.grid,
        moving=["wing"],
        symmetry=["symmetry"],
        method=md.Hybrid(md.IDW(alpha=0.3), md.TFI()),
        comm=comm,
    )
    steps = []
    for time in (0.05, 0.1, 0.25):
        displacement = solver(mesh.points, time)
        step = mesh.deform(displacement)
        if not step.valid:
            step = mesh.deform(displacement, steps="auto")
        print(f"t = {time}: {step}", file=sys.stderr)
        steps.append(step)
    if comm is None or comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        md.write(steps[-1].grid, folder / "bent.cgns", force=True)
    return steps


if __name__ == "__main__":
    world = None
    if "--mpi" in sys.argv:
        from mpi4py import MPI

        world = MPI.COMM_WORLD
    folders = [word for word in sys.argv[1:] if not word.startswith("--")]
    main(Path(folders[0] if folders else "."), world)
