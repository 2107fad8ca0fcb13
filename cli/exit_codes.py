"""Exit codes of all commands; a process ended by a signal exits with 128 plus the signal number."""

EXIT_BUG, EXIT_INPUT, EXIT_INVALID, EXIT_INTERRUPTED = 1, 2, 3, 130
