"""Points, triangles and quads in space: which coincide, where they lie, whether they cross; rotations."""
