"""Loops over shared arrays by threads and MPI ranks."""

from .loops import (
    OneRank,
    Ranks,
    Shared,
    alone,
    carried,
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

__all__ = [
    "OneRank",
    "Ranks",
    "Shared",
    "alone",
    "carried",
    "current_ranks",
    "empty",
    "for_chunks",
    "for_items",
    "for_rows",
    "set_ranks",
    "set_threads",
    "sharing",
    "thread_count",
]
