"""NASA neutral map files."""

from .reader import read_neutral_map, write_neutral_map

__all__ = ["read_neutral_map", "write_neutral_map"]
