"""Measures of cells and grid lines, their totals and gradients."""
