"""Numbers of the energy of repairs that were tuned together, and the studies that measure them.

How good repaired grids are: ``studies/robustness_table.py``, ``studies/random_flows.py`` and
``studies/default_method.py``; how smoothly they move: ``studies/smoothness.py``. Results are in docs/validity.md and
docs/series.md. Whoever changes one number runs these studies for all of them.
"""

import numpy as np

HEALTHY, SOFT, NORM = 2.5, 0.5, 24.0
"""An element is healthy while its f, regularised by SOFT, is below HEALTHY: sheared by less than 45 degrees, or shorter
or longer by less than 2. The excess log(f / HEALTHY) of the corners of a cell is combined in a NORM, as that of cells
is."""
FULL, POWER = np.log(15.0 / HEALTHY), 3.0
"""A grid whose excess is that of one corner with f = 15 has a share of 1, with which the elastic energy matters
little."""
BETWEEN = np.log(4.0 / HEALTHY)
"""Samples of a hexahedron between its corners count from this excess on, that of one corner with f = 4: few are
negative below, and in a grid with many weak cells they are more than half of the work."""
SOFTENED = 0.5
"""Power of the weights of cells while they are untangled."""
CUBIC = 2.0
"""Of the energy that is minimised: the larger, the more the worst cells count."""
POLISHED = 0.25
"""Power of the weights of cells where a healthy grid is polished: those at walls are good already."""
REACH = 32
SHARE = 0.4
"""Cells count more up to REACH cells from walls, and up to this share of the largest distance in the grid: where
there is little room, walls must give, too."""
FALL, FIRST, STEEP = 2.5, 400.0, 4.0
"""At a share s of that distance, cells count s^-FALL times as much, and those in layer l at least FIRST / l^STEEP times
that distance in cells."""
THIN, GROWTH, HEAVIEST = 50.0, 1.25, 40.0
"""Cells of aspect ratio a weigh (a / THIN)^GROWTH, but at least 1 and at most HEAVIEST."""
