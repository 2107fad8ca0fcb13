"""Threads of a process, MPI ranks, and arrays of which every rank holds a part."""

from .loops import current_sharing, empty, for_chunks, for_items, set_sharing, sharing, thread_count
from .nodes import Nodes
from .ranks import ONE_PROCESS, Ranks, WholeGridNeeded

__all__ = [
    "ONE_PROCESS",
    "Nodes",
    "Ranks",
    "WholeGridNeeded",
    "current_sharing",
    "empty",
    "for_chunks",
    "for_items",
    "set_sharing",
    "sharing",
    "thread_count",
]
