"""Numbers of IDW that were tuned together, and the studies that set them.

The exponents and the transition: large motions of the samples and of third-party grids, ``studies/which_method.py`` and
``studies/robustness_table.py``; random motions of whole boundaries, ``studies/random_flows.py``. Their results are in
docs/methods.md ("IDW") and docs/validity.md. Whoever changes one number runs these studies for all of them.
"""

ALPHA_CAP = 0.3
"""Largest alpha that eq. 18 may choose: larger values cross cells with a = 3 and shares by weight."""
FAR, FAR_IN_PLANES = 3.0, 2.5
"""Exponent a of eq. 16: Luke's, and that of ``lie`` in plane grids without a transition.

The weights of a surface fall off as r^(2 - a), those of a curve as r^(1 - a): between two surfaces Luke's exponent
spreads the deformation evenly, between two curves it concentrates it half-way.
"""
FAR_OF_ONE_BODY = 4.0
"""Exponent a of eq. 16 for one moving body: with the transition, it only matters along the body."""
WIDTH, WIDTH_IN_PLANES = 0.5, 0.3
"""Fraction of the gap at either end over which the slope of the share changes (``transition``)."""
ROUNDS = 8
"""Rounds of smoothing near sharp edges with ``lie``."""
STEEPER = 1.5
"""Fast sums are made more accurate by this factor, because the share may vary faster than the weights."""
