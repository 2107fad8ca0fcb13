"""Numbers of the fast sums that were tuned together, and the benchmarks that measure them.

Speed and error of IDW's sums: ``benchmarks/run.py --only idw``, of RBF's: ``benchmarks/run.py --only rbf``. Results are
in docs/performance.md ("Fast IDW sums", "Radial basis functions"). The numbers balance time against accuracy: whatever
they are, errors are measured against exact sums and the sums made finer until the tolerance is kept. Whoever changes
one number runs these benchmarks for all of them.
"""

# IDW, and what it has in common with RBF

LEAF = 24
"""Sources in a cluster that is not split further."""
REGION = 8
"""Bricks of a region."""
REFERENCE_RATIO = 5.0
"""Ratio of distance to half width for which the number of points along a box's longest side is meant."""
SHARE = 16.0
"""The error allowed to one cluster, as a multiple of the error allowed to all together, is this divided by the square
of (interpolation order - 2): errors of many clusters mostly cancel, small ones less so."""
SINGLE_TOLERANCE = 1e-3
"""From this tolerance upwards single precision is enough; it adds less than a hundredth of it."""

# RBF at nodes

RADIAL_LEAF = 48
"""Centres in a cluster that is not split further."""
RADIAL_REGION = 64
"""Targets in a box that is not split further, about."""
CAPACITY = 350
"""Targets in a leaf of their tree."""
TERMS = 1e-7
"""Accuracy of polynomials, relative to the function at the radius of the box."""
REFERENCE, HIGHEST = 2.5, 14
"""Distance, in radii of the box, for which terms of polynomials are chosen, and their highest degree."""
SKELETONS = 1e-6
"""Accuracy of skeletons, relative to the function at the radius of the cluster."""
SPHERES = ((1.0, 120), (1.4, 60), (2.5, 40), (6.0, 30))
"""Spheres of proxy points: radius in those of the cluster, and number of points."""
REACH = 2.0
"""Distance, in radii of a cluster, from which others see it as far."""
TRIALS, TRIAL_LEAVES, AIM = 6, 24, 0.25
"""Errors of clusters cancel as much as the coefficients do, which only trials on some leaves show. AIM is the fraction
of the tolerance that they have to reach, because other leaves can be worse."""

# RBF at the centres

NESTED_LEAF = 96
"""Centres in a cluster of nested sums that is not split further."""
