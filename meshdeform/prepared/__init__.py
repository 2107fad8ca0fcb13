"""A grid prepared for many deformations: its preparation, the deformation, its derivative and result."""
