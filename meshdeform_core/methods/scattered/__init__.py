"""Scattered-data interpolation: IDW and RBF."""
