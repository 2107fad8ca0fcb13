"""What a run would do and take: dry runs, forecasts of memory, disk and time."""
