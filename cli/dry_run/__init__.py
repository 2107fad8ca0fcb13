"""Dry runs: what a run would do, whether it would succeed, and forecasts of its memory, disk space and time."""
