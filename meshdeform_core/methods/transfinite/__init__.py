"""Transfinite interpolation of edges, faces and blocks."""
