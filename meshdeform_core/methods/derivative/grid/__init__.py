"""Derivatives of methods with respect to the grid on which they are prepared, too: what steps after the first need."""
