"""The block faces of a grid: their pieces, their likely roles, and the outer surfaces that they form."""
