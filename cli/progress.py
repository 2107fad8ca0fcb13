"""A progress bar on a terminal, for whatever takes longer than a second."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING

from meshdeform_core import interruption

from .messages import tell

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_PATIENCE = 1.0
# Loops that a run with fast sums takes.
_LOOPS = 24
_UNCACHED = "at every start: no folder for them can be written; NUMBA_CACHE_DIR may name one"


class ProgressBar:
    """Callback for the core's progress; shows nothing unless stderr is a terminal and a stage takes its time.

    That loops are being compiled is said in any case, unless it is not ``enabled``.
    """

    def __init__(self, enabled: bool = True):
        self._wanted = enabled
        self._enabled = enabled and sys.stderr.isatty()
        self._started: dict[str, float] = {}
        self._bar: Bar | None = None
        self._tasks: dict[str, int] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        interruption.check()
        if not self._enabled:
            return
        start = self._started.setdefault(stage, time.perf_counter())
        if self._bar is None and time.perf_counter() - start < _PATIENCE:
            return
        bar = self._bar or self._open()
        if stage not in self._tasks:
            self._tasks[stage] = bar.add_task(stage, total=total)
        bar.update(self._tasks[stage], completed=done, total=total)  # type: ignore[arg-type]

    def _open(self) -> Bar:
        from rich.console import Console
        from rich.progress import Progress as Bar

        self._bar = Bar(console=Console(stderr=True), transient=True)
        self._bar.start()
        return self._bar

    def _compiling(self, loops: int) -> None:
        from meshdeform_core.numerics.jit import is_cached

        if loops == 0:
            tell("compiling loops, " + ("once per installation" if is_cached() else _UNCACHED))
        # How many loops a run needs is known when it has run.
        self("compile", loops, max(_LOOPS, loops + 1))

    def __enter__(self) -> ProgressBar:
        if self._wanted:
            # Imported late: it loads the compiler, which --help does without.
            from meshdeform_core.numerics.jit import on_compile

            on_compile(self._compiling)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._wanted:
            from meshdeform_core.numerics.jit import on_compile

            on_compile(None)
        if self._bar is not None:
            self._bar.stop()
