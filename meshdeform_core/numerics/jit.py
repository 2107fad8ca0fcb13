"""How loops are compiled: cached on disk, without the interpreter lock, with numpy's rules for division.

Numpy's error model matters for speed: Python's tests every divisor for zero, which prevents vectorisation.

The first run after installation has to wait for compilation. The cost grows with the number of functions and of
distinct array operations, not with the length of a loop: scalar loops compile fastest; slice assignments, array
expressions, ``zeros``, reductions and searches each instantiate functions of numba's own.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache

# numba tries the typing rules of an operation in the order in which they were imported. Without this import, the rules
# for characters, lists and dictionaries would precede those for arrays, which costs a tenth of the compile time.
from numba.core.typing import arraydecl as _arrays_first  # noqa: F401

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


class _CompileClock(event.Listener):
    """Counts the loops compiled, not those loaded from the cache, and the time that compiling takes."""

    def __init__(self) -> None:
        self.seconds, self.loops, self.cached = 0.0, 0, True
        self.notice: Callable[[int], None] | None = None
        self._depth, self._start, self._collecting = 0, 0.0, True

    # Called under numba's compiler lock, hence by one thread at a time.
    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._start = time.perf_counter()
            if self.notice:
                self.notice(self.loops)
            # Garbage collection would take a sixth of the compile time, as the compiler allocates millions of objects.
            self._collecting = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._start
            self.loops += 1
            if self._collecting:
                gc.enable()


_clock = _CompileClock()
event.register("numba:compile", _clock)


class _Cache(FunctionCache):
    """numba's cache; where its files are unusable, a loop is compiled again instead of ending the program."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # Entries are pickled: unpickling a class that an update has moved raises whatever its import raises.
            try:
                self.flush()
            except OSError:
                self.disable()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError:
            _clock.cached = False


def _compiled(**options: Any) -> Callable[[Callable], Any]:
    """A decorator: ``numba.njit`` with the options common to all loops plus ``options``."""

    def decorate(function: Callable) -> Any:
        loop = njit(**_OPTIONS, **options)(function)
        try:
            loop._cache = _Cache(function)
        except RuntimeError:
            # No cache folder is writable, neither beside the source nor in the user's home.
            _clock.cached = False
        return loop

    return decorate


kernel = _compiled(no_cfunc_wrapper=True)
"""Decorator for loops whose results must not depend on the order of operations."""

fast_kernel = _compiled(no_cfunc_wrapper=True, fastmath=True)
"""Decorator for sums: additions may be reordered, so that loops are vectorised."""

summing_kernel = _compiled(no_cfunc_wrapper=True, fastmath={"reassoc", "contract"})
"""As :data:`fast_kernel`, where infinite values and NaN must keep their meaning, as decisions depend on them."""

contracted_kernel = _compiled(no_cfunc_wrapper=True, fastmath={"contract"}, forceinline=True)
"""Decorator for functions that may fuse multiplications with additions but must not reorder operations."""

inlined = _compiled(inline="always")
"""Decorator for parts of a loop: inlined before compilation, with the options of the calling loop."""


def compile_seconds() -> float:
    """Seconds that this process has spent compiling so far."""
    return _clock.seconds


def compiled_loops() -> int:
    """Number of loops that this process has compiled so far."""
    return _clock.loops


def is_cached() -> bool:
    """Whether compiled loops are kept on disk; otherwise every start compiles what it needs."""
    return _clock.cached


def on_compile(notice: Callable[[int], None] | None) -> None:
    """Call ``notice`` with the number of loops compiled so far whenever one is compiled as it is not in the cache."""
    _clock.notice = notice
