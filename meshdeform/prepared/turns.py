"""A process-wide lock: API calls run one at a time, as each sets the threads and ranks of all loops."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Re-entrant, as a thread may call again, for example from a function that returns displacements.
_lock = threading.RLock()


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Wait for calls of other threads to end."""
    with _lock:
        yield


def _renew() -> None:
    """Make a new lock in a forked process, where the thread that held the old one does not exist."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
