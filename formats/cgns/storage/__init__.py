"""Storage of CGNS trees in files: HDF5 (read and written) and ADF (read)."""
