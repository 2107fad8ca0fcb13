"""Numbers by which it is judged whether a displacement table belongs to a grid, and which walls it moves.

Together they decide that a table of this grid is taken, whether its points are nodes or lie between them, and that one
in another unit, order or frame is refused with the reason. The tables that must be told apart are in
``tests/core/test_tables.py``, ``tests/core/test_table_frames.py`` and ``tests/core/test_early_warnings.py``; whoever
changes one number runs them all.
"""

# Which surfaces of the grid a table lies on

SAMPLE = 5000
"""Points of the table, at most, that are located."""
ON_BOUNDARY = 0.5
"""A table with a smaller share of its points on the boundary is refused: it belongs to another grid."""
POINTS = 0.5
"""A surface belongs to the table if at least this share of the table's points lies on it, ..."""
COVERED = 0.5
"""... or if the table covers at least this share of its area."""
SOME = 0.1
"""Without such a surface: those with at least this fraction of the points of the best one."""
WHOLE = 0.9
"""A surface of another guessed role than a wall counts as one if the table covers this share of its area."""

# Which nodes follow it, and how

OWN, SAME_NODE = 0.9, 1e-3
"""A table is one of nodes if this share of its points lies on nodes, within this part of the shortest edge there."""
REACH = 0.1
"""Nodes of the walls farther from a table than this part of its diagonal do not follow it."""
ASTRAY = 0.5
"""A table with a larger fraction of its points off the walls that it moves, or of nodes without a face that moves as a
whole, is refused if there is reason to think that it belongs elsewhere."""
OFFSET = 0.1
"""Matched points farther away than this fraction of the shortest edge are reported as not on the wall."""
SMOOTH = 0.85
"""Faces whose normals have at least this cosine belong to one smooth surface."""
ABRUPT = 1e-2
"""A jump of the displacement by more than this fraction of the shortest edge tears the wall."""

# In which other frame it would fit

FRAME_SAMPLE = 2000
"""Points of the table, at most, that are tried in every frame."""
FITS = 0.9
"""A frame is proposed if this share of the points would lie on the nodes, ..."""
GAIN = 0.25
"""... and if this share exceeds that of the points as given by at least so much."""
SPREAD = 0.2
"""Points that fit spread over at least this part of the diagonal of the nodes, or of the wall around them: a table
shrunk to a point lies on any wall."""
PROBES, ON_NODE = 12, 0.05
"""So many points tell a shift onto nodes, within this part of the shortest edge there."""
COUNTED = 3
"""Largest number of points whose first coordinates may be consecutive whole numbers by chance; of more points they are
their numbers."""
