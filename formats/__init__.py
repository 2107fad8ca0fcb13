"""File formats: grids, boundary information, displacement tables, cases and reports.

``read_grid`` and ``write_grid`` are the entry points; format modules are imported when first needed, so that reading a
Plot3D file does not import h5py. All readers and writers raise FormatError for files that are missing, damaged or not
of their format, for options that they do not know, and for grids that a format cannot hold.
"""

from .grids import FORMATS, read_grid, write_grid

__all__ = ["FORMATS", "read_grid", "write_grid"]
