"""The process: exit codes, messages and streams, signals, ranks started by ``mpiexec``, and the display of progress."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

import click

from meshdeform_core import interruption
from meshdeform_core.parallel import Ranks
from meshdeform_core.wording import counted

if TYPE_CHECKING:
    from meshdeform_core.numerics.jit import Compiled

EXIT_BUG, EXIT_INPUT, EXIT_INVALID, EXIT_INTERRUPTED = 1, 2, 3, 130
"""Exit codes of all commands; a process ended by a signal exits with 128 plus the signal number."""
# A second signal within this time (s), as from an impatient user or a process group, does not interrupt the clean-up.
_IMPATIENCE = 0.5
_FRAGILE = "llvmlite."
"""Modules that no exception may leave: what they were about to free would be freed once more by its destructor."""
_AGAIN = 0.01
"""Seconds after which it is tried again to raise an exception that had to wait."""
# Environment variables in which launchers pass a process its rank and the number of ranks.
_LAUNCHERS = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),  # Open MPI
    ("PMI_RANK", "PMI_SIZE"),  # MPICH, Intel MPI, Microsoft MPI
    ("PMIX_RANK", "SLURM_STEP_NUM_TASKS"),  # srun --mpi=pmix
)
# M_MMAP_THRESHOLD of mallopt(3), which only the GNU C library has.
_MMAP_THRESHOLD = -3
PATIENCE = 1.0
"""Runs longer than this have a bar (seconds)."""
SELDOM, SELDOMEST, _GROWTH = 10.0, 60.0, 0.5
"""If stderr is not a terminal, a line states the progress after SELDOM seconds, then at intervals that grow with the
time taken, up to SELDOMEST seconds."""
_TICK = 0.1
_UNCACHED = "at every start: no folder for them can be written; NUMBA_CACHE_DIR may name one"
_OUTER = "levels"


def tell(message: str) -> None:
    """Print a message on stderr; failing to do so is ignored."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(f"meshdeform: {message}", err=True)


def open_streams() -> None:
    """Occupy the descriptors of stdin, stdout and stderr if the caller closed them.

    A file opened while descriptor 1 is closed would get this number and receive everything printed. Messages to a
    closed stderr are lost; writing to a closed stdout fails, as it does on a full disk.
    """
    for number, name, mode, access in (
        (0, "stdin", "r", os.O_RDWR),
        (1, "stdout", "w", os.O_RDONLY),
        (2, "stderr", "w", os.O_RDWR),
    ):
        try:
            os.fstat(number)
        except OSError:
            # The system assigns the lowest free number, which is the missing one.
            os.open(os.devnull, access)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names are bytes and need not be UTF-8.
            stream.reconfigure(errors="surrogateescape")


def flushed(stream: TextIO) -> str:
    """Flush stdout or stderr; returns the reason of a failure. Output that cannot be written is dropped."""
    try:
        stream.flush()
    except (OSError, ValueError) as error:
        drop(stream)
        return (isinstance(error, OSError) and error.strerror) or str(error)
    return ""


def drop(stream: TextIO) -> None:
    """Discard what a stream still buffers; otherwise the interpreter complains at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Handler:
    """Handler of the signals that end the program, of all that the caller does not ignore (as nohup ignores SIGHUP)."""

    def __init__(self) -> None:
        self._last = -_IMPATIENCE
        self._finishing = False
        self._numbers: list[int] = []
        sys.unraisablehook = _unraisable
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, self)
                self._numbers.append(number)
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, self._again)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self._finishing:
            os._exit(128 + number)
        interruption.request(number)
        last, self._last = self._last, time.monotonic()
        if self._last - last >= _IMPATIENCE:
            self._stop(frame)

    def _stop(self, frame: FrameType | None) -> None:
        """Raise an exception, so that half-written files are removed on the way out; where that is unsafe, soon."""
        while frame is not None and not str(frame.f_globals.get("__name__")).startswith(_FRAGILE):
            frame = frame.f_back
        if frame is not None and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        else:
            interruption.check()

    def _again(self, _: int, frame: FrameType | None) -> None:
        # A check elsewhere may have come first: cleaning up must not be interrupted.
        if not interruption.raised():
            self._stop(frame)

    def finish(self) -> None:
        """Ignore signals once everything is written: an exception would be lost in the interpreter's shutdown."""
        self._finishing = True
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        if interruption.requested() is not None:
            # The exit code is already determined.
            for number in self._numbers:
                signal.signal(number, signal.SIG_IGN)


def _unraisable(lost: Any) -> None:
    """Python discards exceptions raised in callbacks of the garbage collector; the next check raises it again."""
    if not (isinstance(lost.exc_value, SystemExit) and interruption.requested() is not None):
        sys.__unraisablehook__(lost)


def end_of(number: int) -> str:
    """Message for a program ended by a signal."""
    how = "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"
    advice = interruption.advice()
    return f"{how}; no output was left half-written" + (f"; {advice}" if advice else "")


class Start(NamedTuple):
    """How the program was started, which click hands on: the arguments, which reports quote, and the ranks."""

    arguments: tuple[str, ...]
    ranks: Ranks


def place() -> tuple[int, int] | None:
    """Rank of this process and number of ranks according to the launcher; ``None`` for a single process."""
    for names in _LAUNCHERS:
        texts = [os.environ.get(name, "") for name in names]
        if all(text.isdigit() for text in texts) and int(texts[1]) > 1:
            return int(texts[0]), int(texts[1])
    return None


def run_on_ranks(run: Callable[[Ranks], int], here: tuple[int, int]) -> int:
    """Run the command on every rank; only the first one prints. Returns the exit code, the same on all ranks.

    A rank that fails alone ends the others.
    """
    (number, count), reason = here, ""
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        # RuntimeError: mpi4py found no MPI library.
        reason = f"mpi4py is missing ({error}); pip install mpi4py, or start without mpiexec"
    else:
        if MPI.COMM_WORLD.size != count:
            library = MPI.Get_library_version().split(",")[0]
            reason = f"mpi4py uses {library}, which sees {MPI.COMM_WORLD.size}; use the mpiexec of that MPI"
    if reason:
        # Without MPI the ranks cannot communicate, but the launcher's numbers determine which one prints.
        if number:
            return 0
        tell(f"error: started on {count} ranks, but {reason}")
        return EXIT_INPUT
    from meshdeform_core.parallel.ranks import MPIRanks

    # Let the C library return freed arrays of 16 MiB and more to the system, and the end of its heap. By default it
    # keeps up to 64 MiB for later. With 1 MiB instead of 16, a quarter of the time of a rank went into pages that the
    # system cleared.
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 1 << 24)
    ranks = MPIRanks(MPI.COMM_WORLD)
    messages = io.StringIO()
    with contextlib.ExitStack() as silence:
        if ranks.number:
            nothing = silence.enter_context(open(os.devnull, "w", encoding="utf-8"))
            silence.enter_context(contextlib.redirect_stdout(nothing))
            silence.enter_context(contextlib.redirect_stderr(messages))
        try:
            code = run(ranks)
        except SystemExit as stop:
            # A signal: see meshdeform_cli.main.
            code = stop.code if isinstance(stop.code, int) else 1
    return ranks.conclude(code, messages.getvalue(), complete=code in (0, EXIT_INVALID))


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
        self._clock: Any = None
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
        expected = max(compiled.expected, compiled.done + 1)
        if not self._told:
            self._told = True
            many = f"{counted(expected, 'loop')} in {counted(compiled.processes, 'process', 'processes')}"
            often = "once per installation" if self._clock and self._clock.cached else _UNCACHED
            tell(f"compiling {many}, about {max(compiled.seconds, 1):.0f} s, {often}")
        self("compile", compiled.done, expected)

    def __enter__(self) -> ProgressBar:
        ProgressBar.active = self
        if self._compiles:
            # Imported late, as it loads the compiler, which many commands do not need.
            from meshdeform_core.numerics.jit import compile_clock

            self._clock = compile_clock
            compile_clock.notice = self._compiling if self._enabled else None
        if self._enabled:
            show = self._draw if sys.stderr.isatty() else self._log
            self._display = threading.Thread(target=show, daemon=True)
            self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        ProgressBar.active = None
        if self._clock is not None:
            self._clock.notice = None
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
