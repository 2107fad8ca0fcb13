"""The block faces of a grid: their pieces, the roles they are likely to have, and the outer surfaces they form."""
