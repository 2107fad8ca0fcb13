"""Grids of the library: the public object, its files and pictures, grids as arguments."""
