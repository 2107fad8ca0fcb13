"""Progress of work that takes longer than a second: a bar on a terminal, lines at growing intervals in a log."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from meshdeform_core import interruption

from .messages import tell

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

PATIENCE = 1.0
"""Stages longer than this have a bar (seconds)."""
LOGGED = 1.0
"""If stderr is not a terminal, runs longer than this end with a line of their stages (seconds)."""
SELDOM, SELDOMEST = 10.0, 60.0
"""If stderr is not a terminal, a line states the progress after SELDOM seconds, then at intervals that grow with the
time taken, up to SELDOMEST seconds."""
_GROWTH = 0.5
# Stages that would be shown as 0.0 s are left out.
_LISTED = 0.05
_TICK = 0.1
# Number of loops compiled for a run with fast sums.
_LOOPS = 24
_UNCACHED = "at every start: no folder for them can be written; NUMBA_CACHE_DIR may name one"
_OUTER = "levels"

Extent = Callable[[], tuple[int, int]]
"""Returns the amount done and the total."""


class ProgressBar:
    """Callback for the core's progress, ``bar(stage, done, total)``; ``total`` is 0 if unknown.

    On a terminal, a stage that takes longer than a second is shown with the time remaining. Elsewhere, long work is
    logged at intervals, and a run of more than a second ends with a line of the times of its stages. Compiling of loops
    is announced in either case, unless the bar is not ``enabled`` or nothing ``compiles``.
    """

    active: ProgressBar | None = None

    def __init__(self, enabled: bool = True, compiles: bool = True):
        self._wanted, self._loops, self._compiles = enabled, compiles, enabled and compiles
        self._shown = enabled and sys.stderr.isatty()
        self._start = time.perf_counter()
        self._stage, self._began = "", self._start
        self._extent: Extent = lambda: (0, 0)
        self._levels: tuple[int, int] | None = None
        self._seconds: dict[str, float] = {}
        self._over = threading.Event()
        self._display: threading.Thread | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        interruption.check()
        if stage == _OUTER:
            self._levels = done, total
        else:
            self._enter(stage, lambda: (done, total))

    @contextlib.contextmanager
    def stage(self, name: str, extent: Extent) -> Iterator[None]:
        """A stage whose code does not report progress; it is polled by calling ``extent``."""
        self._enter(name, extent)
        try:
            yield
        finally:
            self._enter("", lambda: (0, 0))

    def _enter(self, stage: str, extent: Extent) -> None:
        if stage != self._stage:
            now = time.perf_counter()
            if self._stage:
                self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._began
            self._stage, self._began = stage, now
        self._extent = extent

    def _compiling(self, loops: int) -> None:
        from meshdeform_core.numerics.jit import is_cached

        if loops == 0:
            tell("compiling loops, " + ("once per installation" if is_cached() else _UNCACHED))
        # The number of loops that a run needs is known only afterwards.
        self("compile", loops, max(_LOOPS, loops + 1))

    def __enter__(self) -> ProgressBar:
        ProgressBar.active = self
        if self._loops:
            # Imported late, as it loads the compiler, which many commands do not need.
            from meshdeform_core.numerics.jit import on_compile

            on_compile(self._compiling if self._compiles else None)
        if self._wanted:
            display = self._show if self._shown else self._log
            self._display = threading.Thread(target=display, name="progress", daemon=True)
            self._display.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        ProgressBar.active = None
        if self._compiles:
            from meshdeform_core.numerics.jit import on_compile

            on_compile(None)
        self._over.set()
        if self._display is not None:
            self._display.join()
        self._enter("", lambda: (0, 0))
        elapsed = time.perf_counter() - self._start
        stages = [f"{name} {seconds:.1f} s" for name, seconds in self._seconds.items() if seconds >= _LISTED]
        if self._wanted and not self._shown and error is None and elapsed > LOGGED and stages:
            tell(", ".join(stages))

    def _show(self) -> None:
        """Draw until the end; runs in a separate thread, because long stages do not call back."""
        while not self._over.wait(_TICK):
            if time.perf_counter() - self._began > PATIENCE:
                with _bar() as bar:
                    tasks: dict[str, TaskID] = {}
                    while not self._over.wait(_TICK):
                        self._update(bar, tasks)

    def _log(self) -> None:
        """Log the progress at intervals; runs in a separate thread."""
        elapsed = 0.0
        while not self._over.wait(min(SELDOMEST, max(SELDOM, _GROWTH * elapsed))):
            elapsed = time.perf_counter() - self._start
            parts = [_words(_OUTER, *self._levels)] if self._levels else []
            if self._stage:
                parts.append(_words(self._stage, *self._extent()))
            tell(", ".join([f"{elapsed:.0f} s", *parts]))

    def _update(self, bar: Bar, tasks: dict[str, TaskID]) -> None:
        """One task for the levels of a series, if it is one, and one for the current stage."""
        stage, extent = self._stage, self._extent
        lines = [(_OUTER, self._levels)] if self._levels else []
        if stage and time.perf_counter() - self._began > PATIENCE:
            lines.append((stage, extent()))
        for name in [name for name in tasks if name not in dict(lines)]:
            bar.remove_task(tasks.pop(name))
        for name, (done, total) in lines:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=None)
            bar.update(tasks[name], completed=min(done, total), total=total or None)


def _words(stage: str, done: int, total: int) -> str:
    return f"{stage} {min(done, total):,} of {total:,}" if total else stage


def _bar() -> Bar:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(),
        TextColumn("remaining"), TimeRemainingColumn(),
    )  # fmt: skip
    return Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Show the progress of reading a file, in the current bar or in a new one."""
    total = path.stat().st_size if path.is_file() else 0
    with _stage("read", _counted("rchar", total)):
        yield


@contextlib.contextmanager
def writing(total: int) -> Iterator[None]:
    """Show the progress of writing about ``total`` bytes."""
    with _stage("write", _counted("wchar", total)):
        yield


@contextlib.contextmanager
def _stage(name: str, extent: Extent) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        bar = ProgressBar.active or stack.enter_context(ProgressBar(compiles=False))
        stack.enter_context(bar.stage(name, extent))
        yield


def _counted(counter: str, total: int) -> Extent:
    """Counts the bytes that this process transfers from now on; (0, 0) where the system does not count them."""
    before = _moved(counter)

    def extent() -> tuple[int, int]:
        done = _moved(counter) - before
        # Memory-mapped files are not counted.
        return (done, total) if done > 0 else (0, 0)

    return extent


def _moved(counter: str) -> int:
    try:
        lines = Path("/proc/self/io").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(counter)), 0)
