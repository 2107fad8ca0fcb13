"""Slow twins: the same mathematics in plain numpy, written to be read."""
