"""The running process: signals, ranks, threads, its streams and what they show of its progress."""
