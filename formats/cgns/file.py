"""Open a CGNS file as a tree, in either container; remarks collected while it is read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from meshdeform_core.errors import FormatError
from meshdeform_core.wording import listed

from .adf import is_adf, read_adf
from .tree import MAXIMUM_DEPTH, Node

# About thirty nodes per zone, including its connections.
_MOST_NODES = 10_000_000


@contextmanager
def opened_cgns(path: Path) -> Iterator[Node]:
    """Root node of a CGNS file; the tree can be read while the context lasts."""
    if is_adf(path):
        yield read_adf(path)
    else:
        # Imported here because ADF files, the majority, need no HDF5.
        from .hdf5 import opened_hdf5

        with opened_hdf5(path) as root:
            yield root


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Prefix messages about the file's tree with its name."""
    try:
        yield
    except FormatError as error:
        message = str(error)
        raise FormatError(message if str(path) in message else f"{path}: {message}") from error
    except RecursionError as error:
        raise FormatError(f"{path} has a chain of too many links") from error


def linked_files(path: Path) -> Iterator[Path]:
    """The files that the links of a CGNS file lead to; links are not followed, so that circular links end."""
    if not is_adf(path):
        from .hdf5 import external_targets

        yield from external_targets(path)
        return
    waiting, count = [(read_adf(path), 0)], 0
    while waiting:
        node, depth = waiting.pop()
        for child in node.children:
            count += 1
            if count > _MOST_NODES or depth > MAXIMUM_DEPTH:
                raise FormatError(f"{path} has more nodes than any CGNS file; it is damaged")
            if child.link is None:
                waiting.append((child, depth + 1))
            elif child.link.file and not child.dangling:
                yield child.target.file


class Notes:
    """Remarks for ``Grid.notes``; the same remark about several nodes becomes one line."""

    def __init__(self) -> None:
        # The places of each remark, in order and without repetition.
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        self._places.setdefault(remark, {})[place] = None

    def lines(self) -> tuple[str, ...]:
        """One line per remark, e.g. ``rind planes are ...: zone 1, zone 2 ... and 7 more``."""
        return tuple(f"{remark}: {listed(places)}" for remark, places in self._places.items())
