"""A progress bar on a terminal, for work that takes longer than a second."""

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
# Number of loops in a run with fast sums.
_LOOPS = 24
_UNCACHED = "at every start, as no folder for them is writable; set NUMBA_CACHE_DIR to one that is"


class ProgressBar:
    """Callback for the core's progress; shows nothing unless stderr is a terminal and a stage takes long.

    Compiling of loops is always announced, unless the bar is not ``enabled``.
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
        # The number of loops that a run needs is only known at its end.
        self("compile", loops, max(_LOOPS, loops + 1))

    def __enter__(self) -> ProgressBar:
        if self._wanted:
            # Imported late: it loads the compiler, which --help does not need.
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
