"""A request to stop: set by a signal handler, honoured wherever the program can stop safely.

A signal handler raises an exception, but code that the signal happens to interrupt (library callbacks, destructors)
may swallow it. The request itself persists, and :func:`check` raises again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

_requests: list[int] = []
_deferrals: list[None] = []
_pending: list[Callable[[], object]] = []
_advice: list[Callable[[], str]] = []
_raised: list[None] = []


def request(signal_number: int) -> None:
    """Ask the program to stop because of a signal."""
    _requests.append(signal_number)


def requested() -> int | None:
    """Number of the first signal received, or ``None``."""
    return _requests[0] if _requests else None


def check() -> None:
    """Raise ``SystemExit`` with the exit code of the signal if the program was asked to stop."""
    if _requests and not _deferrals:
        _raised.append(None)
        raise SystemExit(128 + _requests[0])


def raised() -> bool:
    """Whether :func:`check` has raised an exception."""
    return bool(_raised)


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Let :func:`check` raise only after the block has ended, for libraries that no exception may pass through."""
    _deferrals.append(None)
    try:
        yield
    finally:
        _deferrals.pop()
    check()


@contextlib.contextmanager
def cleaned_up(action: Callable[[], object]) -> Iterator[None]:
    """Run ``action`` when the block ends; if a signal prevents that, :func:`clean_up` does it."""
    _pending.append(action)
    try:
        yield
    finally:
        action()
        _pending.remove(action)


def clean_up() -> None:
    """Run the outstanding actions of interrupted :func:`cleaned_up` blocks."""
    while _pending:
        _pending.pop()()


@contextlib.contextmanager
def continued_by(advice: Callable[[], str]) -> Iterator[None]:
    """Let ``advice`` say how the work can be continued if a signal ends the block; empty if it cannot."""
    _advice.append(advice)
    try:
        yield
    finally:
        # The exception raised by a signal may have been replaced by another one.
        if not _requests:
            _advice.remove(advice)


def advice() -> str:
    """How to continue work that a signal has ended; empty if there is nothing to continue."""
    return _advice[-1]() if _advice else ""
