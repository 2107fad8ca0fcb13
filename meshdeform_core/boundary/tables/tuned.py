"""Thresholds that decide whether a displacement table belongs to a grid, and which walls it moves.

A table of the grid must be accepted whether its points are nodes or lie between them; a table in another unit, order or
frame must be refused with the reason. The tables to be distinguished are in ``tests/core/test_tables.py``,
``tests/core/test_table_frames.py`` and ``tests/core/test_early_warnings.py``; after changing a threshold, run all
three.
"""

# Which surfaces of the grid a table lies on

SAMPLE = 5000
"""Largest number of the table's points that are located on the boundary."""
ON_BOUNDARY = 0.5
"""A table with a smaller share of its points on the boundary is refused: it belongs to another grid."""
POINTS = 0.5
"""A surface belongs to the table if at least this share of the table's points lies on it, ..."""
COVERED = 0.5
"""... or if the table covers at least this share of its area."""
SOME = 0.1
"""If there is no such surface: those with at least this fraction of the number of points on the best one."""
WHOLE = 0.9
"""A surface whose guessed role is not a wall counts as a wall if the table covers this share of its area."""

# Which nodes follow it, and how

OWN, SAME_NODE = 0.9, 1e-3
"""A table holds nodes of the grid if this share of its points lies on nodes, within this fraction of the shortest edge
there."""
REACH = 0.1
"""Nodes of the walls farther from a table than this fraction of its diagonal do not follow it."""
ASTRAY = 0.5
"""A table is refused, if there is reason to think that it belongs elsewhere, when more than this fraction of its points
lies off the walls that it moves, or of the nodes that it moves belongs to no face all of whose nodes move."""
OFFSET = 0.1
"""Matched points farther away than this fraction of the shortest edge are reported as not on the wall."""
SMOOTH = 0.85
"""Faces whose normals have at least this cosine belong to one smooth surface."""
ABRUPT = 1e-2
"""A jump of the displacement by more than this fraction of the shortest edge tears the wall."""

# In which other frame it would fit

FRAME_SAMPLE = 2000
"""Largest number of the table's points that are tried in every frame."""
FITS = 0.9
"""A frame is proposed if this share of the points would lie on the nodes, ..."""
GAIN = 0.25
"""... and if this share exceeds that of the points as given by at least this much."""
SPREAD = 0.2
"""Points that fit must extend over at least this fraction of the diagonal of the nodes, or of the wall around them, as
a table shrunk to a point lies on any wall."""
PROBES, ON_NODE = 12, 0.05
"""Number of points by which a shift onto nodes is found, and its tolerance as a fraction of the shortest edge there."""
COUNTED = 20
"""Up to this number of points, whole numbers that all differ as first coordinates may be chance; of more points, they
are point numbers."""
