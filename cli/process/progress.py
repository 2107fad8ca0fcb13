"""Progress of work that takes longer than a second: a bar on a terminal, lines at growing intervals in a log."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from meshdeform_core import interruption
from meshdeform_core.wording import counted

from .messages import tell

if TYPE_CHECKING:
    from meshdeform_core.numerics.jit import Compiled

PATIENCE = 1.0
"""Runs longer than this have a bar (seconds)."""
SELDOM, SELDOMEST, _GROWTH = 10.0, 60.0, 0.5
"""If stderr is not a terminal, a line states the progress after SELDOM seconds, then at intervals that grow with the
time taken, up to SELDOMEST seconds."""
_TICK = 0.1
_UNCACHED = "at every start: no folder for them can be written; NUMBA_CACHE_DIR may name one"
_OUTER = "levels"


class ProgressBar:
    """Callback for the core's progress, ``bar(stage, done, total)``; ``total`` is 0 if unknown.

    On a terminal, a run that takes longer than a second has a bar with the time remaining of its stage. Elsewhere, long
    work is logged at intervals. Compiling of loops is announced in either case, unless the bar is not ``enabled`` or
    nothing ``compiles``.
    """

    active: ProgressBar | None = None

    def __init__(self, enabled: bool = True, compiles: bool = True):
        self._enabled, self._compiles, self._told = enabled, compiles, False
        self._start = time.perf_counter()
        self._levels: tuple[str, int, int] | None = None
        self.current: tuple[str, int, int] | None = None
        self._over = threading.Event()
        self._display: threading.Thread | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        interruption.check()
        if stage == _OUTER:
            self._levels = stage, min(done, total), total
        else:
            self.current = stage, min(done, total), total

    def _under_way(self) -> list[tuple[str, int, int]]:
        """The levels of a series, if it is one, and the current stage, with the amounts done and in total."""
        return [line for line in (self._levels, self.current) if line]

    def _compiling(self, compiled: Compiled) -> None:
        from meshdeform_core.numerics.jit import is_cached

        expected = max(compiled.expected, compiled.done + 1)
        if not self._told:
            self._told = True
            many = f"{counted(expected, 'loop')} in {counted(compiled.processes, 'process', 'processes')}"
            often = "once per installation" if is_cached() else _UNCACHED
            tell(f"compiling {many}, about {max(compiled.seconds, 1):.0f} s, {often}")
        self("compile", compiled.done, expected)

    def __enter__(self) -> ProgressBar:
        ProgressBar.active = self
        if self._compiles:
            # Imported late, as it loads the compiler, which many commands do not need.
            from meshdeform_core.numerics.jit import on_compile

            on_compile(self._compiling if self._enabled else None)
        if self._enabled:
            show = self._draw if sys.stderr.isatty() else self._log
            self._display = threading.Thread(target=show, daemon=True)
            self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        ProgressBar.active = None
        if self._compiles:
            from meshdeform_core.numerics.jit import on_compile

            on_compile(None)
        self._over.set()
        if self._display is not None:
            self._display.join()

    def _draw(self) -> None:
        """Draw on a terminal; in a thread, because long stages do not call back."""
        if self._over.wait(PATIENCE):
            return
        from rich.console import Console
        from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn

        columns = (*Progress.get_default_columns(), TextColumn("remaining,"), TimeElapsedColumn(), TextColumn("taken"))
        with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bar:
            tasks: dict[str, TaskID] = {}
            while not self._over.wait(_TICK):
                lines = self._under_way()
                for name in set(tasks) - {name for name, _, _ in lines}:
                    bar.remove_task(tasks.pop(name))
                for name, done, total in lines:
                    if name not in tasks:
                        tasks[name] = bar.add_task(name, total=None)
                    bar.update(tasks[name], completed=done, total=total or None)

    def _log(self) -> None:
        """Log the progress at intervals, in a thread."""
        elapsed = 0.0
        while not self._over.wait(min(SELDOMEST, max(SELDOM, _GROWTH * elapsed))):
            elapsed = time.perf_counter() - self._start
            lines = [f"{name} {done:,} of {total:,}" if total else name for name, done, total in self._under_way()]
            tell(", ".join([f"{elapsed:.0f} s", *lines]))


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """A stage whose code does not report progress, of the current bar, or with a bar of its own."""
    with contextlib.ExitStack() as stack:
        bar = ProgressBar.active or stack.enter_context(ProgressBar(compiles=False))
        bar.current = name, 0, 0
        try:
            yield
        finally:
            bar.current = None
