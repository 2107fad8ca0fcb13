"""SIGINT, SIGTERM and SIGHUP end the program with 130, 143 and 129, whatever code they interrupt."""

from __future__ import annotations

import os
import signal
import sys
import time
from types import FrameType
from typing import Any

from meshdeform_core import interruption

# A second signal within this time (s), as from an impatient user or a process group, does not interrupt the clean-up.
_PATIENCE = 0.5
_FRAGILE = "llvmlite."
"""Modules that no exception may leave: what they were about to free would be freed once more by its destructor."""
_AGAIN = 0.01
"""Seconds after which it is tried again to raise an exception that had to wait."""


class Handler:
    """Handler of the signals that end the program."""

    def __init__(self) -> None:
        self._last = -_PATIENCE
        self._finishing = False
        self._numbers: list[int] = []

    def install(self) -> None:
        """Handle every signal that the caller does not ignore (as nohup ignores SIGHUP)."""
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
        if self._last - last >= _PATIENCE:
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
