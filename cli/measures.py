"""Names of the cell measures, for commands."""

from __future__ import annotations

MEASURES = (
    "f_skew", "scaled_jacobian", "jacobian", "relative_jacobian", "volume", "volume_ratio", "aspect_ratio",
    "growth_ratio", "non_orthogonality_deg", "skewness", "wall_normal_deviation_deg", "first_cell_height_ratio",
    "interface_kink_deg", "interface_spacing_jump", "wall_distance", "displacement",
)  # fmt: skip
"""Defined in ``meshdeform_core.quality.fields``; repeated because ``--help`` must not load compiled loops."""
