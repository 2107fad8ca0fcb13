"""Refusing work that does not fit before the memory is taken."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import MethodError

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")


def readable(size: float) -> str:
    """``1.5 GiB`` and the like."""
    unit = 0
    while size >= 1024 and unit < len(_UNITS) - 1:
        size, unit = size / 1024, unit + 1
    return f"{size:.3g} {_UNITS[unit]}"


@dataclass(frozen=True)
class MemoryLimit:
    """How much memory a run may take.

    ``size`` in bytes; ``source`` says whose limit it is, like ``--max-memory allows`` or ``the machine has``.
    """

    size: int
    source: str

    def require(self, needed: int, what: str, instead: str) -> None:
        """Refuse ``what`` if it needs more.

        Raises
        ------
        MethodError
            With the size, the limit and what to do instead.
        """
        if needed > self.size:
            raise MethodError(f"{what} needs about {readable(needed)}, {self.source} {readable(self.size)}; {instead}")

    def after(self, taken: int, what: str) -> MemoryLimit:
        """What is left of the limit for methods when ``what`` has taken its part."""
        return MemoryLimit(max(self.size - taken, 0), f"{self.source}, after {readable(taken)} for {what},")


UNLIMITED = MemoryLimit(2**62, "the machine has")
