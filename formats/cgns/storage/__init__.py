"""How CGNS trees lie in files: HDF5, read and written, and ADF, read."""
