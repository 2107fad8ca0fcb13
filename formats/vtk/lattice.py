"""Nodes on the product of three axes, as rectilinear grids and images of VTK have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

# Nodes that a few axes or a spacing may define, regardless of the size of the file, and per byte of a larger one.
_LATTICE_NODES = 1_000_000
_LATTICE_NODES_PER_BYTE = 10


def require_plausible_lattice(path: Path, nodes: int, size: int) -> None:
    """Refuse axes whose product needs memory out of proportion to the ``size`` of the file in bytes.

    Raises
    ------
    FormatError
        With the number of nodes and the accepted number.
    """
    most = max(_LATTICE_NODES, _LATTICE_NODES_PER_BYTE * size)
    if nodes > most:
        raise FormatError(
            f"{path} declares {nodes} nodes, but has only {size} bytes; a lattice of more than {most} nodes is read "
            "only from a file with explicit coordinates: save it as a structured grid (.vts)"
        )


def lattice(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> NDArray[Any]:
    """Nodes of the product of three axes, ``(nk, nj, ni, 3)``."""
    along_z, along_y, along_x = np.meshgrid(z, y, x, indexing="ij")
    return np.stack([along_x, along_y, along_z], axis=-1)
