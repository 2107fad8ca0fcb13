"""How loops are compiled: cached on disk, without the interpreter lock, with numpy's rules for division.

Numpy's error model matters for speed: Python's tests every divisor for zero, which prevents vectorisation.

The first run after installation has to wait for compilation. The cost grows with the number of functions and of
distinct array operations, not with the length of a loop: scalar loops compile fastest; slice assignments, array
expressions, ``zeros``, reductions and searches each instantiate functions of numba's own. Loops that declare the types
of their arguments are compiled by several processes (:class:`Compilers`) as soon as the first one is missing.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .processor import choose_processor

# Before numba is imported, which reads the processor's name once.
choose_processor()

from numba import njit, types  # noqa: E402
from numba.core import event  # noqa: E402
from numba.core.caching import (  # noqa: E402
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.core.runtime import rtsys  # noqa: E402

# numba tries the typing rules of an operation in the order in which they were imported. Without this import, the rules
# for characters, lists and dictionaries would precede those for arrays, which costs a tenth of the compile time.
from numba.core.typing import arraydecl as _arrays_first  # noqa: E402, F401

from ..parallel.loops import usable_cores  # noqa: E402

T = TypeVar("T")

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_LIBRARIES = ("numpy", "numba", "llvmlite", "math", "builtins")
SECONDS_PER_LOOP = 1.1
"""Time that a loop takes on average while all cores compile: 46 loops took two processes 25.6 s (`make demo`)."""


class Compiled(NamedTuple):
    """How far compiling has come: loops compiled, loops known to be missing, processes that compile them."""

    done: int
    expected: int
    processes: int

    @property
    def seconds(self) -> float:
        """How long compiling all of them takes, roughly."""
        return SECONDS_PER_LOOP * max(self.expected, 1) / self.processes


class _CompileClock(event.Listener):
    """Counts the ``loops`` that this process compiles, not those loaded from the cache, and the ``seconds`` that it
    spends compiling, or waiting for others that do.

    ``cached`` tells whether compiled loops are kept on disk; otherwise every start compiles what it needs.
    ``notice`` is called whenever a loop is compiled as it is not in the cache.
    """

    def __init__(self) -> None:
        self.seconds, self.loops, self.cached = 0.0, 0, True
        self.notice: Callable[[Compiled], None] | None = None
        self._depth, self._start, self._collecting = 0, 0.0, True

    @property
    def busy(self) -> bool:
        """Whether a loop is being compiled."""
        return self._depth > 0

    # Called under numba's compiler lock, hence by one thread at a time.
    def on_start(self, event: Any) -> None:
        self.begin()

    def on_end(self, event: Any) -> None:
        self.loops += self.end()

    def begin(self) -> None:
        """A loop begins to be compiled, or waited for, maybe for another one that calls it."""
        if self._depth == 0:
            self._start = time.perf_counter()
            if self.notice:
                self.notice(Compiled(self.loops, *_compilers.extent()))
            # Garbage collection would take a sixth of the compile time, as the compiler allocates millions of objects.
            self._collecting = gc.isenabled()
            gc.disable()
        self._depth += 1

    def end(self) -> bool:
        """The loop is finished; returns whether it was an outer one."""
        self._depth -= 1
        if self._depth > 0:
            return False
        self.seconds += time.perf_counter() - self._start
        if self._collecting:
            gc.enable()
        return True


class _Unwritable(InTreeCacheLocator):
    """The folder of a source file, for looking only: chosen where no folder can be written."""

    @classmethod
    def from_function(cls, py_func: Callable, py_file: str) -> _Unwritable:
        return cls(py_func, py_file)


class _Places(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _Unwritable]  # noqa: RUF012


class _Cache(FunctionCache):
    """numba's cache of a loop.

    Where numba's falls short: compiled loops are found in folders that this process may not write to, such as those
    of an installation by another user; they are compiled again after a change of any function that they call, in
    whatever file; and where a file of the cache is unusable, the loop is compiled instead of ending the program.
    """

    _impl_class = _Places

    def __init__(self, function: Callable, declared: dict[tuple[Any, ...], str]):
        super().__init__(function)
        if isinstance(self._impl.locator, _Unwritable):
            compile_clock.cached = False
        self._function, self._declared = function, declared
        self._files: list[IndexDataCacheFile] = []

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found, name = self._load(sig, target_context), self._declared.get(tuple(getattr(sig, "args", sig)))
        # Within another loop no third one is compiled meanwhile: it may call the first, which is not finished.
        if found is None and name is not None and compile_clock.cached and not compile_clock.busy:
            _compilers.begin(name)
            compile_clock.begin()
            try:
                # Within another loop's time, hence not counted by the clock.
                compile_clock.loops += _compilers.obtain(name)
            finally:
                compile_clock.end()
            found = self._load(sig, target_context)
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        # What numba's refresh() also does, importing how to compile each of its functions, takes longer than all loads.
        rtsys.initialize(target_context)
        key = self._index_key(sig, target_context.codegen())
        for file in self._places():
            try:
                data = file.load(key)
                if data is not None:
                    return self._impl.rebuild(target_context, data)
            except Exception:
                # Entries are pickled: unpickling a class that an update has moved raises whatever its import raises.
                try:
                    file.flush()
                except OSError:
                    self.disable()
        return None

    def _places(self) -> list[IndexDataCacheFile]:
        """The files in which the loop may be found, the writable one last."""
        if not self._files:
            stamp, _ = source_of(self._function)
            # numba's own stamp is that of the file which contains the loop.
            self._cache_file = IndexDataCacheFile(self.cache_path, self._impl.filename_base, stamp)
            source = self._function.__code__.co_filename
            elsewhere = (InTreeCacheLocator, UserWideCacheLocator)
            known = (UserProvidedCacheLocator,) if os.environ.get("NUMBA_CACHE_DIR") else elsewhere
            folders = [where(self._function, source).get_cache_path() for where in known]
            others = [folder for folder in folders if folder != self.cache_path and Path(folder).is_dir()]
            self._files = [IndexDataCacheFile(folder, self._impl.filename_base, stamp) for folder in others]
            self._files.append(self._cache_file)
        return self._files

    def holds(self, sig: Any, target_context: Any) -> bool:
        """Whether the loop is in the cache."""
        key = self._index_key(sig, target_context.codegen())
        try:
            return any(file.load(key) is not None for file in self._places())
        except Exception:
            return False

    def save_overload(self, sig: Any, data: Any) -> None:
        self._places()
        if isinstance(self._impl.locator, _Unwritable):
            return
        try:
            super().save_overload(sig, data)
        except OSError:
            compile_clock.cached = False


@cache
def _digest_of_file(path: str, _modified: int) -> bytes:
    return hashlib.sha256(Path(path).read_bytes()).digest()


def source_of(function: Callable) -> tuple[bytes, set[int]]:
    """Digest of what a loop is compiled from, the files of all functions that it calls and constants of others; and the
    identities of the functions, its own among them."""
    parts, seen = set[bytes](), set[int]()

    def visit(value: Any) -> None:
        called = getattr(value, "py_func", None) or getattr(value, "_defn", None) or value
        code = getattr(called, "__code__", None)
        if isinstance(value, int | float | str | bytes | tuple):
            parts.add(repr(value).encode())
        elif isinstance(value, np.ndarray):
            parts.add(value.tobytes())
        elif code is not None and id(called) not in seen and not called.__module__.startswith(_LIBRARIES):
            seen.add(id(called))
            parts.add(_digest_of_file(code.co_filename, Path(code.co_filename).stat().st_mtime_ns))
            codes = [code]
            for each in codes:
                for name in each.co_names:
                    visit(called.__globals__.get(name))
                # The functions within it.
                codes += (constant for constant in each.co_consts if isinstance(constant, CodeType))
            for cell in called.__closure__ or ():
                visit(cell.cell_contents)

    visit(function)
    return hashlib.sha256(b"".join(sorted(parts))).digest(), seen


# Starting a process, which imports numba, costs as much as compiling so many loops.
_WORTH_A_PROCESS = 3
_LOOK_AGAIN = 0.02
"""Seconds between two looks at what other processes have finished."""


class Compilers:
    """Loops that are missing from the cache, compiled in several processes from when the first one is asked for.

    numba compiles under one lock, hence processes instead of threads. Whoever needs a loop that another process is
    compiling takes the next missing one meanwhile. A process that fails or is killed costs time only: its loop is
    compiled by whoever needs it. ``missing()`` are the names of all declared loops that are not in the cache;
    ``calls(one, other)`` tells whether a loop calls another.
    """

    def __init__(
        self, missing: Callable[[], list[str]], compile: Callable[[str], object], calls: Callable[[str, str], bool]
    ):
        self._missing, self._compile, self._calls = missing, compile, calls
        self._pending, self._running = list[str](), set[str]()
        self._known, self._processes = set[str](), list[subprocess.Popen[str]]()
        self._count = 1
        self._change = threading.Condition()

    def extent(self) -> tuple[int, int]:
        """How many loops were found missing so far, and how many processes compile them."""
        return len(self._known), self._count

    def obtain(self, name: str | None = None) -> int:
        """Return when the loop, by default every one, is in the cache, or this process has to compile it itself.

        Returns how many other loops it compiled meanwhile. Called under numba's compiler lock, hence by one thread at
        a time, after :meth:`begin`.
        """
        compiled = 0
        while True:
            with self._change:
                if name in self._pending:
                    self._pending.remove(name)
                    return compiled
                if name not in self._running if name else not (self._pending or self._running):
                    return compiled
                # numba takes a loop that calls the one which is waited for as a recursion of that one.
                free = [each for each in self._pending if name is None or not self._calls(each, name)]
                if free:
                    self._pending.remove(free[-1])
                else:
                    self._change.wait(_LOOK_AGAIN)
            if free:
                self._compile(free[-1])
                compiled += 1

    def all(self) -> int:
        """Compile all missing loops and return how many there were."""
        self.begin("")
        count = len(self._pending) + len(self._running)
        self.obtain()
        return count

    def begin(self, name: str) -> None:
        """Find what is missing and start processes for it, unless the loop of this name is known to be."""
        if name in self._known:
            return
        new = [name for name in self._missing() if name not in self._known]
        with self._change:
            self._known.update(new)
            self._pending.extend(new)
            wanted = min(usable_cores() - 1, len(self._pending) // _WORTH_A_PROCESS)
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
                [sys.executable, "-c", f"from {__name__} import serve; serve()"],
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


_declared: dict[str, tuple[Any, Any]] = {}
"""Loops with the types of their arguments, by name and number of these; the modules imported so far declare them."""

_records: dict[type, Any] = {}
"""numba's types of named tuples that loops take."""


def record(fields: str, *records: type) -> Callable[[type[T]], type[T]]:
    """Decorator of a named tuple that loops take; declares the types of its fields, as :data:`kernel` does."""

    def declare(kind: type[T]) -> type[T]:
        _records[kind] = types.NamedTuple(_types(fields, records), kind)
        return kind

    return declare


def _types(declared: str, records: Iterable[type]) -> tuple[Any, ...]:
    """numba's types for ``"f8[:, ::1], i8"``; the names of ``records`` stand for their types."""
    names = vars(types) | {kind.__name__: _records[kind] for kind in records}
    return eval(f"({declared},)", names)


def _compiled(options: dict[str, Any], *declared: Any) -> Any:
    """A decorator, or the loop it makes of a function: ``numba.njit`` with options common to all loops and ``options``.

    Loops that Python calls declare the types of their arguments, and the named tuples among them, so that any process
    can compile them: ``@kernel("f8[:, ::1], Boxes", Boxes)``; several texts for several kinds of arguments. Without
    types, a loop is compiled where it is called.
    """

    texts = [each for each in declared if isinstance(each, str)]

    def decorate(function: Callable) -> Any:
        loop = njit(**_OPTIONS, **options)(function)
        name = f"{function.__module__}.{function.__qualname__}"
        records = [each for each in declared if isinstance(each, type)]
        keys = {_types(text, records): f"{name}:{number}" for number, text in enumerate(texts)}
        loop._cache = _Cache(function, keys)
        _declared.update((key, (loop, arguments)) for arguments, key in keys.items())
        return loop

    return decorate if texts else decorate(*declared)


def declared_loops() -> dict[str, list[tuple[Any, ...]]]:
    """The types of arguments that each loop declares, by its name, of the modules imported so far."""
    found = dict[str, list[tuple[Any, ...]]]()
    for key, (_, arguments) in _declared.items():
        found.setdefault(key.rpartition(":")[0], []).append(arguments)
    return found


def missing_loops() -> list[str]:
    """Names of the declared loops that are not in the cache."""
    return [
        name
        for name, (loop, arguments) in _declared.items()
        if arguments not in loop.overloads and not loop._cache.holds(arguments, loop.targetctx)
    ]


def compile_declared(name: str) -> None:
    """Compile a loop for types that it declares."""
    loop, arguments = _declared[name]
    loop.compile(arguments)


def loop_calls(one: str, other: str) -> bool:
    """Whether a declared loop calls another one, itself or through a third; names as in :func:`missing_loops`."""
    return id(_declared[other][0].py_func) in source_of(_declared[one][0].py_func)[1]


compile_clock = _CompileClock()
_compilers = Compilers(missing_loops, compile_declared, loop_calls)
event.register("numba:compile", compile_clock)


kernel = partial(_compiled, {"no_cfunc_wrapper": True})
"""Decorator for loops whose results must not depend on the order of operations."""

fast_kernel = partial(_compiled, {"no_cfunc_wrapper": True, "fastmath": True})
"""Decorator for sums: additions may be reordered, so that loops are vectorised."""

contracted_kernel = partial(_compiled, {"no_cfunc_wrapper": True, "fastmath": {"contract"}, "forceinline": True})
"""Decorator for functions that may fuse multiplications with additions but must not reorder operations."""

inlined = partial(_compiled, {"inline": "always"})
"""Decorator for parts of a loop: inlined before compilation, with the options of the calling loop."""


def compile_all() -> int:
    """Compile all declared loops of the modules imported so far; returns how many were missing."""
    return _compilers.all()


def serve() -> None:
    """Compile the loops whose names arrive on standard input; run in a process of its own."""
    # Its parent decides: it closes the stream, or kills this process at its own end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Busy for good: it is told what is missing, and starts no processes of its own.
    compile_clock.begin()
    for line in sys.stdin:
        name = line.strip()
        importlib.import_module(name.rpartition(":")[0].rpartition(".")[0])
        compile_declared(name)
        print(name, flush=True)
