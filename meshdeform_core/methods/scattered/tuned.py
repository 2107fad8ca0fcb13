"""Parameters of IDW that were tuned together, and the studies that set them.

The exponents and the transition result from large motions of the samples and of third-party grids
(``studies/which_method.py``, ``studies/robustness_table.py``) and from random motions of whole boundaries
(``studies/random_flows.py``); see docs/methods.md ("IDW") and docs/validity.md. After changing any of them, run all
three studies.
"""

ALPHA_CAP = 0.3
"""Largest alpha that eq. 18 may choose; larger values cross cells if a = 3 and there is no transition."""
FAR, FAR_IN_PLANES = 3.0, 2.5
"""Exponent a of eq. 16: Luke's, and that of ``lie`` in plane grids without a transition.

The weights of a surface decay like r^(2 - a), those of a curve like r^(1 - a): between two surfaces Luke's exponent
spreads the deformation evenly, between two curves it concentrates the deformation half-way.
"""
FAR_OF_ONE_BODY = 4.0
"""Exponent a of eq. 16 for one moving body with a transition; it then matters only along the body."""
WIDTH, WIDTH_IN_PLANES = 0.5, 0.3
"""Fraction of the gap at either end over which the slope of the share changes (``transition``)."""
ROUNDS = 8
"""Rounds of smoothing near sharp edges with ``lie``."""
STEEPER = 1.5
"""With a transition, fast sums are made accurate for displacements larger by this factor, as the share may vary faster
than the weights."""

DIRECT_CENTRES = 4000
"""Of RBF, the largest number of centres that ``auto`` solves directly; beyond it, GMRES with its set-up is faster
(``benchmarks/rbf.py``)."""
