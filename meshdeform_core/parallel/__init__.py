"""Loops over shared arrays by threads and MPI ranks."""

from .loops import (
    OneRank,
    Ranks,
    Shared,
    alone,
    current_ranks,
    empty,
    for_chunks,
    for_items,
    for_rows,
    set_ranks,
    set_threads,
    sharing,
    thread_count,
)
from .reuse import allow, reusing_memory, uninitialised
from .tasks import Task, tasks_running

__all__ = [
    "OneRank",
    "Ranks",
    "Shared",
    "Task",
    "allow",
    "alone",
    "current_ranks",
    "empty",
    "for_chunks",
    "for_items",
    "for_rows",
    "reusing_memory",
    "set_ranks",
    "set_threads",
    "sharing",
    "tasks_running",
    "thread_count",
    "uninitialised",
]
