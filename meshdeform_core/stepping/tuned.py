"""Parameters of the attempts at a valid grid that were tuned together, and the studies that measure them.

How many large motions succeed, and what the attempts cost: ``studies/robustness_table.py`` and
``studies/default_method.py``; results are in docs/validity.md. Whoever changes one number runs these studies for all of
them.
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
RESCUE_STEPS = (8, 16)
"""Numbers of steps without repairs in which it is tried first (studies/repairs.py, pipes that close to 3 %)."""
SQUEEZED = ("tfi", RESCUE)
"""Methods tried when the best valid grid is nearly collapsed; in narrow gaps TFI often preserves grid lines better."""
