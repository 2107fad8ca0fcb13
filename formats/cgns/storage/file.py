"""Open a CGNS file as a tree, in either container."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from meshdeform_core.errors import FormatError

from .adf import is_adf, read_adf
from .tree import Node


@contextmanager
def opened_cgns(path: Path) -> Iterator[Node]:
    """Root node of a CGNS file; the tree can be read while the context lasts.

    Raises
    ------
    FormatError
        When the file is missing, damaged or not CGNS, at once or when the damaged part is reached.
    """
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
