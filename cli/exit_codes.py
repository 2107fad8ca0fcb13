"""Exit codes of all commands; processes that a signal ends exit with 128 plus its number."""

EXIT_BUG, EXIT_INPUT, EXIT_INVALID, EXIT_INTERRUPTED = 1, 2, 3, 130
