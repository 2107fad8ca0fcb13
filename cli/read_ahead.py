"""The grid is read, and its joints are found, while the rest of the program is imported.

Both take about as long: imports are Python, most of the other work is numpy and HDF5, which leave the interpreter to
others.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from meshdeform_core.memory import MemoryLimit, left_for_method
from meshdeform_core.parallel import Task, current_ranks, thread_count

from .process.progress import reading

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_core.grid.joints import Joints

    from .options import GridInput

# Seconds after which a thread that computes in Python lets others have the interpreter: calls of numpy are short.
_SWITCH = 3e-5


class ReadAhead:
    """Begins to read ``source`` on a thread of its own, if there may be one, and goes on to its joints.

    The input is checked in the same order as without it: errors of the grid are raised by :meth:`grid`, which is called
    once the case is known to be sound. With one thread, or on several ranks, nothing is done ahead. The joints of a
    grid that does not fit into ``memory``, the limit of the run, are not looked for.
    """

    def __init__(self, source: GridInput, memory: MemoryLimit) -> None:
        self.source, self.memory = source, memory
        self._ahead = thread_count() > 1 and current_ranks().count == 1
        self._tolerance: float | None = None
        self._abandoned = False
        self._interval: float | None = None

    def __enter__(self) -> ReadAhead:
        if self._ahead:
            # What the other thread imports.
            for name in ("meshdeform_formats.grids", "meshdeform_core.grid.joints"):
                importlib.import_module(name)
            self._interval = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH)
            self._grid: Task[Grid] = Task(self.source.from_file)
            self._joints: Task[Joints | None] = Task(self._find)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._abandoned = True
        self._settle()

    def _settle(self) -> None:
        """Both threads need the interpreter no more."""
        if self._interval is not None:
            sys.setswitchinterval(self._interval)
            self._interval = None

    def grid(self, boundary_file: Path | None, tolerance: float) -> Grid:
        """The grid, with the boundary file of the case; ``tolerance`` is that of the case, for the joints.

        Raises
        ------
        MeshDeformError
            What :meth:`GridInput.read` raises.
        """
        if not self._ahead:
            return self.source.read(boundary_file)
        from meshdeform_core.numerics.rows import load_first_loop

        self._tolerance = tolerance
        load_first_loop()
        with reading(self.source.path):
            return self.source.with_boundaries(self._grid.result(), boundary_file)

    def joints(self, grid: Grid, tolerance: float) -> Joints:
        """How the blocks of :meth:`grid` are joined.

        Raises
        ------
        GridError
            What :func:`find_joints` raises.
        """
        from meshdeform_core.grid.joints import find_joints

        found = self._joints.result() if self._ahead else None
        self._settle()
        # The search may have begun before the tolerance of the case was known.
        return found if found and found.tolerance == tolerance else find_joints(grid, tolerance)

    def _find(self) -> Joints | None:
        from meshdeform_core.grid.joints import find_joints
        from meshdeform_core.grid.topology import RELATIVE_TOLERANCE
        from meshdeform_core.numerics.jit import load_compiler

        grid = self._grid.result()
        left_for_method(self.memory, grid.n_nodes, grid.points.nbytes)
        if self._abandoned:
            return None
        # Its loops may be the first.
        load_compiler()
        return find_joints(grid, self._tolerance or RELATIVE_TOLERANCE)
