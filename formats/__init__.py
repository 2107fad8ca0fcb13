"""File formats: grids, boundary information, displacement tables, cases and reports.

``read_grid`` and ``write_grid`` are the entry points; format modules are imported when first needed, so that reading a
Plot3D file does not import h5py.
"""

from .grids import FORMATS, read_grid, write_grid

__all__ = ["FORMATS", "read_grid", "write_grid"]
