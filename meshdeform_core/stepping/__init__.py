"""A motion imposed in steps, and the attempts made until the grid is valid."""
