"""Exact sums over sources, every target with every source, and the basis functions in them."""
