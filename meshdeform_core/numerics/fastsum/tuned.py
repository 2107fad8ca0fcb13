"""Parameters of the fast sums that were tuned together, and the benchmarks that measure them.

``benchmarks/run.py --only idw`` and ``--only rbf`` measure speed and error; results are in docs/performance.md ("Fast
IDW sums", "Radial basis functions"). The parameters affect time only, not accuracy: errors are measured against exact
sums, and the sums are refined until they keep the tolerance. After changing any of them, run both benchmarks.
"""

# IDW, and parameters shared with RBF

LEAF = 24
"""Largest number of sources in a leaf."""
REGION = 8
"""Number of bricks in a region."""
REFERENCE_RATIO = 5.0
"""Ratio of distance to half width for which the interpolation order along a box's longest side is chosen."""
SHARE = 16.0
"""This divided by (interpolation order - 2)^2 is the error allowed to one cluster, as a multiple of that allowed to the
whole sum: the errors of many clusters mostly cancel, small ones less so."""
SINGLE_TOLERANCE = 1e-3
"""From this tolerance upwards single precision is used; it adds less than a hundredth of the tolerance."""

# RBF at nodes

RADIAL_LEAF = 48
"""Largest number of centres in a leaf of the source tree."""
RADIAL_REGION = 64
"""Approximate number of leaves of the target tree in a region."""
CAPACITY = 350
"""Approximate number of targets in a leaf of the target tree."""
TERMS = 1e-7
"""Accuracy of polynomials, relative to the function at a distance of the box radius."""
REFERENCE, HIGHEST = 2.5, 14
"""Distance, in box radii, for which the terms of polynomials are chosen, and their highest degree."""
SKELETONS = 1e-6
"""Accuracy of skeletons, relative to the function at a distance of the cluster radius."""
SPHERES = ((1.0, 120), (1.4, 60), (2.5, 40), (6.0, 30))
"""Spheres of proxy points: radius in cluster radii, and number of points."""
REACH = 2.0
"""Distance, in cluster radii, from which a cluster is far."""
TRIALS, TRIAL_LEAVES, AIM = 6, 24, 0.25
"""Largest number of trials, leaves per trial, and the fraction of the tolerance that errors there must keep, as other
leaves may be worse. Trials are needed because errors of clusters cancel to an extent that depends on coefficients."""

# RBF at the centres

NESTED_LEAF = 96
"""Largest number of centres in a leaf of nested sums."""
