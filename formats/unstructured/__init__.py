"""A grid as unstructured hexahedra (2-D: quads) for other tools; the boundary as named groups of faces."""
