"""The process: signals, ranks, threads, streams, and the display of progress."""
