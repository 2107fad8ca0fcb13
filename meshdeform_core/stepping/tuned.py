"""Parameters of the attempts at a valid grid that were tuned together, and the studies that measure them.

How many large motions succeed, and what the attempts cost: ``studies/robustness_table.py`` and
``studies/default_method.py``; results are in docs/validity.md. How many repairs have a second solution, and what the
search for it costs: ``studies/smoothness.py``, results in docs/series.md. Whoever changes one number runs these studies
for all of them.
"""

MAX_HALVINGS, MAX_REPAIRED_HALVINGS = 8, 4
"""How often a step may be halved until the grid is valid: by the method alone, and with a repair of each step, which is
far more expensive."""
MAX_ATTEMPTS = 24
"""Largest number of steps tried with repairs, to bound the time spent on hopeless cases."""
BEFORE = 0.9
"""If the boundary crosses itself, this fraction of the motion up to that point is tried and reported to the user."""
RESCUE = "rbf-tfi"
"""The method tried when the chosen one finds no valid grid: it succeeds most often."""
SQUEEZED = ("tfi", RESCUE)
"""Methods tried when the best valid grid is nearly collapsed; in narrow gaps TFI often preserves grid lines better."""

# The search for a second solution of a repair

SAME = 1e-3
"""Two grids are the same minimum if no node differs by more than this fraction of its shortest edge."""
PART, PARTS = 0.875, 12
"""A motion is followed from the largest fraction PART^n, n <= PARTS, at which the method alone keeps the grid valid, in
at most STEPS steps; the first is 1 - PART, and none is shorter than SHORTEST."""
SHORTEST, STEPS = 0.01, 24
EFFORT = 120
"""Newton steps after which no further step is taken: twice to three times what it takes to find a far minimum."""
NEAR, ENOUGH = 0.02, 0.1 * SAME
"""Distance from the minimum, relative to local edges, to which it is computed on the way and in the end."""
FOLLOWED = 50_000
"""Largest number of nodes for which a motion is followed."""
