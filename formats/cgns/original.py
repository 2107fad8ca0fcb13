"""What a copy of a CGNS file needs to know of its original, if nothing but the values of coordinates changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from meshdeform_core.grid import Shape

from ..planes import Stored
from .adf import is_adf
from .zone import Base, Zone


class Original(NamedTuple):
    """A file in HDF5 whose coordinates are at known places, where a copy has them, too.

    Attributes
    ----------
    state : of the file when it was read, see :func:`state_of`
    names, shapes : of its zones
    dimension : coordinates of each node
    places : the coordinates of each zone
    """

    state: tuple[int, ...]
    names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    dimension: int
    places: tuple[tuple[Stored, ...], ...]

    @classmethod
    def of(
        cls, state: tuple[int, ...], base: Base, zones: Sequence[Zone], places: Sequence[list[Stored] | None]
    ) -> Original | None:
        """``None`` if a copy differs from the file in more: if coordinates are compressed, in other files or zones,
        stored once for several zones, or have boxes, or if the file is in ADF."""
        found = []
        for zone, known in zip(zones, places, strict=True):
            linked = any(node.link for node in (base.node, zone.node, zone.grid, *zone.coordinates))
            if known is None or linked or zone.grid.dims:
                return None
            found.append(tuple(known))
        every = [place.start for known in found for place in known]
        if is_adf(base.node.file) or len(set(every)) < len(every):
            return None
        names, shapes = (tuple(getattr(zone, key) for zone in zones) for key in ("name", "shape"))
        return cls(state, names, shapes, base.dimension, tuple(found))


def state_of(path: Path) -> tuple[int, ...]:
    """What tells whether a file has changed; nothing of a file that cannot be read."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns
