"""Motions of a boundary: rigid, by formulas, by tables over time, by lattices, by sections."""
