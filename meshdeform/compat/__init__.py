"""The interfaces of other programs, so that their callers need not change."""
