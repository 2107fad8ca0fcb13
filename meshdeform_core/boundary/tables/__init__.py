"""Displacement tables: points matched with boundary nodes, units and frames, and the walls a table fits."""
