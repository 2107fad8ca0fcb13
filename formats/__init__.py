"""File formats: grids, boundary information, displacement tables, cases and reports.

``read_grid`` and ``write_grid`` are the two doors; the modules behind them are imported when first needed, so that
reading a Plot3D file never pays for importing h5py or vtk.
"""

from .grids import FORMATS, read_grid, write_grid

__all__ = ["FORMATS", "read_grid", "write_grid"]
