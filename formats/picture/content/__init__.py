"""The content of pictures: polygons of planes and surfaces, walls, the worst cell, values for the colours."""
