"""Threads of a process, MPI ranks, and arrays of which every rank holds a part."""

from .loops import (
    agreed,
    alone,
    carried,
    current_ranks,
    empty,
    for_chunks,
    for_items,
    set_ranks,
    set_threads,
    sharing,
    thread_count,
)
from .nodes import Nodes, WholeGridNeeded, require_undivided
from .ranks import OneRank, Ranks, Route, collected, joined

__all__ = [
    "Nodes",
    "OneRank",
    "Ranks",
    "Route",
    "WholeGridNeeded",
    "agreed",
    "alone",
    "carried",
    "collected",
    "current_ranks",
    "empty",
    "for_chunks",
    "for_items",
    "joined",
    "require_undivided",
    "set_ranks",
    "set_threads",
    "sharing",
    "thread_count",
]
