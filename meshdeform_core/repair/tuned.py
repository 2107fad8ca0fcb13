"""Parameters of the repair energy that were tuned together, and the studies that measure them.

``studies/robustness_table.py``, ``studies/random_flows.py`` and ``studies/default_method.py`` measure the quality of
repaired grids, ``studies/smoothness.py`` how smoothly they move; results are in docs/validity.md and docs/series.md.
After changing any parameter, run all of these studies.
"""

import numpy as np

COLLAPSED = 1e-10
"""A corner whose undeformed Jacobian is below this fraction of the product of its edges is collapsed."""
HEALTHY, SOFT, NORM = 2.5, 0.5, 24.0
"""An element is healthy while its f, regularised by SOFT, is below HEALTHY: in the plane sheared by less than 45
degrees, or stretched or shortened by less than a factor of 2. With it, the nodes of the nozzle are accelerated by .097
of the wall's step, with 2.75 by .124 and with 3 by .19 (studies/smoothness.py, closing, a quarter of the interval). The
excess log(f / HEALTHY) of corners is combined into that of a cell, and that of cells into that of the grid, by the
p-norm with p = NORM."""
AS_PLANE = 2.0 + 0.6 * (HEALTHY - 2.0)
"""Of an extruded grid f is that of its plane grid, where it is larger for the same map. If it is 2.5 there, it is at
least 2.32 in space: (5 D - D^2) / (3 D^(2/3)) + (D^2 + 1) / (2 D) for a determinant D."""
FULL, POWER = np.log(15.0 / HEALTHY), 2.0
"""The share is (excess / FULL)^POWER, 1 for the excess of one corner with f = 15; the elastic energy then matters
little."""
BETWEEN, SLOWLY = np.log(4.0 / HEALTHY), 3.0
"""Samples of a hexahedron between its corners count above the excess BETWEEN, that of one corner with f = 4, and as
much as corners from FULL on: below few are negative, and in a grid with many weak cells they are more than half of the
work. In between their share is the part of that range, to the power SLOWLY."""
ALONG = float((BETWEEN / FULL) ** POWER)
"""In extruded grids, what differs along lines in the method's grid fades out up to this share, that of one corner with
f = 4: a repair that makes them equal at once would jump where it sets in."""
SOFTENED = 0.5
"""Power of the weights of cells while they are untangled."""
CUBIC = 2.0
"""Factor of the cubic term of the energy that is minimised: the larger it is, the more the worst cells count."""
HELD = 0.32
"""The elastic energy of a cell has its weight to this power as a factor: where a repair sets in, cells at walls yield
less suddenly. With 0, nodes of the nozzle are accelerated by .104 of the wall's step (studies/smoothness.py), with .25
the valve keeps a scaled Jacobian of .339, with .5 walls that a method tilts stay tilted (studies/default_method.py)."""
POLISHED = 0.25
"""Power of the weights of cells when a healthy grid is polished, as cells at walls are good already."""
REACH = 32
SHARE = 0.4
"""Cells count more up to REACH cells from walls, and up to this share of the largest distance in the grid: in narrow
gaps, cells at walls must change, too."""
FALL, FIRST, STEEP = 2.5, 400.0, 4.0
"""Weights are s^-FALL at a share s of that distance, and at least FIRST / l^STEEP times that distance (in cells) in
layer l."""
ROOM, CRAMPED = 4.0, 8.0
"""Where that distance r is less than ROOM cells, the latter is (r / ROOM)^CRAMPED times as large: nearly all cells are
at walls there, and the others would be sacrificed to them."""
THIN, GROWTH, HEAVIEST = 50.0, 1.25, 40.0
"""Weights of cells of aspect ratio a are (a / THIN)^GROWTH, limited to 1 ... HEAVIEST."""
LARGE, FEW, PER_NODE = 100_000, 0.1, 400
"""Where more nodes than LARGE may move and less than the share FEW of the cells is bad, only nodes near those move: as
many layers of cells around them as take at most PER_NODE bytes per node of the grid (studies/repairs.py)."""
LAYERS = (2, 4, 8, 16, 32)
"""Numbers of layers from which the neighbourhood of bad cells is chosen."""
KEPT = 0.7
"""A repaired grid keeps at least this share of the smallest scaled Jacobian of a valid grid of the method
(studies/default_method.py)."""
SQUASHED = 0.025
"""Smallest relative Jacobian of the method's grid below which proportionally less is kept (studies/jumps.py)."""
FARTHEST = 5.0
"""No node moves farther than this, times the largest displacement of the boundary."""
COLLAPSING = 0.01
"""Valid cells with a corner below this fraction of its undeformed Jacobian are nearly collapsed and cause a warning."""
