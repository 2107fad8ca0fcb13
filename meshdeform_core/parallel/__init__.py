"""Threads of a process, MPI ranks, and arrays of which every rank holds a part."""

from .loops import (
    Ranks,
    agreed,
    alone,
    current_ranks,
    current_scratch,
    empty,
    for_chunks,
    for_items,
    set_sharing,
    sharing,
    thread_count,
)
from .nodes import Nodes, WholeGridNeeded, require_undivided

__all__ = [
    "Nodes",
    "Ranks",
    "WholeGridNeeded",
    "agreed",
    "alone",
    "current_ranks",
    "current_scratch",
    "empty",
    "for_chunks",
    "for_items",
    "require_undivided",
    "set_sharing",
    "sharing",
    "thread_count",
]
