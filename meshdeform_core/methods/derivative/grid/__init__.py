"""Derivatives of methods also with respect to the grid on which they are prepared, as steps after the first require."""
