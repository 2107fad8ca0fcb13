"""Loops that are missing from the cache, compiled in several processes.

numba compiles under one lock, hence processes instead of threads. Whoever needs a loop that another process is
compiling takes the next missing one meanwhile. A process that fails or is killed costs time only: its loop is compiled
by whoever needs it.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

# Starting a process, which imports numba, costs as much as compiling so many loops.
_WORTH_A_PROCESS = 3
_LOOK_AGAIN = 0.02
"""Seconds between two looks at what other processes have finished."""


class Compilers:
    """Processes that compile loops, started when the first one is missing.

    Parameters
    ----------
    missing : returns the names of all declared loops that are not in the cache
    compile : compiles the loop of a name in this process
    cores : returns how many processes may compile, this one included
    program : Python code of such a process: it compiles the loops whose names it reads, and prints each name then
    """

    def __init__(
        self,
        missing: Callable[[], list[str]],
        compile: Callable[[str], object],
        cores: Callable[[], int],
        program: str,
    ):
        self._missing, self._compile, self._cores, self._program = missing, compile, cores, program
        self._pending, self._running = list[str](), set[str]()
        self._known, self._processes = set[str](), list[subprocess.Popen[str]]()
        self._count = 1
        self._change = threading.Condition()

    def extent(self) -> tuple[int, int]:
        """How many loops were found missing so far, and how many processes compile them."""
        return len(self._known), self._count

    def obtain(self, name: str) -> int:
        """Return when the loop is in the cache, or when this process has to compile it itself.

        Returns how many other loops it compiled meanwhile. Called under numba's compiler lock, hence by one thread at
        a time, after :meth:`begin`.
        """
        compiled = 0
        while True:
            with self._change:
                if name in self._pending:
                    self._pending.remove(name)
                    return compiled
                if name not in self._running:
                    return compiled
                other = self._pending.pop() if self._pending else None
                if other is None:
                    self._change.wait(_LOOK_AGAIN)
            if other is not None:
                self._compile(other)
                compiled += 1

    def all(self) -> int:
        """Compile all missing loops and return how many there were."""
        self.begin("")
        count = len(self._pending) + len(self._running)
        while True:
            with self._change:
                other = self._pending.pop() if self._pending else None
                if other is None and not self._running:
                    return count
                if other is None:
                    self._change.wait(_LOOK_AGAIN)
            if other is not None:
                self._compile(other)

    def begin(self, name: str) -> None:
        """Find what is missing and start processes for it, unless the loop of this name is known to be."""
        if name in self._known:
            return
        new = [name for name in self._missing() if name not in self._known]
        with self._change:
            self._known.update(new)
            self._pending.extend(new)
            wanted = min(self._cores() - 1, len(self._pending) // _WORTH_A_PROCESS)
        if getattr(sys, "frozen", False) or not Path(sys.executable).name.startswith("python"):
            # A program with an interpreter inside cannot be started as one.
            return
        started = wanted - sum(process.poll() is None for process in self._processes)
        for _ in range(started):
            threading.Thread(target=self._feed, name="compiling", daemon=True).start()
        self._count = max(self._count, 1 + started)

    def _feed(self) -> None:
        """Start a process and hand it one loop after the other."""
        # The same modules, in whatever way this process finds them.
        paths = os.pathsep.join(path for path in sys.path if path)
        name = None
        try:
            with subprocess.Popen(
                [sys.executable, "-c", self._program],
                env=os.environ | {"PYTHONPATH": paths},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,
            ) as process:
                self._processes.append(process)
                assert process.stdin is not None
                assert process.stdout is not None
                atexit.register(process.kill)
                while name := self._take():
                    process.stdin.write(name + "\n")
                    process.stdin.flush()
                    if process.stdout.readline() != name + "\n":
                        break
                    self._finish(name)
        except OSError:
            # No process can be started, or it has died: this one compiles what it needs.
            pass
        finally:
            self._finish(name)

    def _take(self) -> str | None:
        with self._change:
            name = self._pending.pop(0) if self._pending else None
            if name:
                self._running.add(name)
            return name

    def _finish(self, name: str | None) -> None:
        with self._change:
            self._running.discard(name or "")
            self._change.notify_all()
