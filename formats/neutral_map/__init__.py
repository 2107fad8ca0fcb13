"""NASA neutral map files."""

from .reader import read_neutral_map
from .write import neutral_map_text, write_neutral_map

__all__ = ["neutral_map_text", "read_neutral_map", "write_neutral_map"]
