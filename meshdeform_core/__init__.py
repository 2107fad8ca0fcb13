"""meshdeform core: grids, boundaries, motions, methods and quality. Arrays in, arrays out; no files."""
