"""Work beside other work: on a second thread if there is one, else when its result is needed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from .loops import current_ranks, mark_beside, thread_count

T = TypeVar("T")

_running: set[threading.Thread] = set()


class Task(Generic[T]):
    """The result of ``make()``, which begins at once on a thread of its own, or when the task ``after`` is done.

    With one thread, or several ranks, whose loops must come in the same order on all of them, ``make`` is called by
    :meth:`result`, the first time. It must neither change what the code beside it uses nor depend on it.
    """

    def __init__(self, make: Callable[[], T], after: Task[Any] | None = None) -> None:
        self._make, self._after, self._lock = make, after, threading.Lock()
        self._outcome: T | None = None
        self._failure: BaseException | None = None
        self._done = False
        self._thread: threading.Thread | None = None
        if thread_count() > 1 and current_ranks().count == 1:
            self._thread = threading.Thread(target=self._run, name="task")
            _running.add(self._thread)
            self._thread.start()

    def result(self) -> T:
        """What ``make`` returned; what it raised is raised here."""
        if self._thread is not None:
            self._thread.join()
        with self._lock:
            if not self._done:
                self._call()
        if self._failure is not None:
            raise self._failure
        return self._outcome  # type: ignore[return-value]

    def _run(self) -> None:
        mark_beside()
        try:
            if self._after is not None and self._after._thread is not None:
                self._after._thread.join()
            self._call()
        finally:
            _running.discard(threading.current_thread())

    def _call(self) -> None:
        try:
            self._outcome = self._make()
        except BaseException as error:
            self._failure = error
        self._done = True


def tasks_running() -> bool:
    """Whether a task is still at work whose result nobody waits for, because an error or a signal ended the rest."""
    return any(thread.is_alive() for thread in list(_running))
