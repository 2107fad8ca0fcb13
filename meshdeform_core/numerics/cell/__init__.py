"""Loops over cells: measures, proof of positive Jacobians, energy of the repair."""
