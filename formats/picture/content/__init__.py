"""What a picture shows of a grid: polygons of planes and surfaces, walls, the worst cell, values for the colours."""
