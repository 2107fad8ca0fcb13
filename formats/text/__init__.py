"""Text that several formats and the command line write: JSON, exact numbers, counted nouns."""
