"""What users are told of a displacement: warnings before it is applied, and why a derivative there is not that of the
displacement field itself, with what is held fixed.

The limits were measured on the splitter plate (Sen et al. section 4; ``studies/largest_angles.py``), which turns
by up to 14 degrees more than the body it is attached to: one step is valid up to a rotation of 54 degrees with TFI, and
of 34 degrees with IDW of displacements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..boundary import Kind
from ..grid import FloatArray, IntArray
from ..numerics.arrays import lengths, total
from ..numerics.tape import largest
from ..wording import Notice
from .base import Kinks, Problem

TFI_ROTATION = 55.0
PLAIN_ROTATION = 35.0
LARGEST_ROTATION = 150.0
"""Largest rotation in one step (degrees) with TFI, with IDW of displacements, and with IDW of rigid motions."""

EDGES = "{} nodes that slide on curved surfaces are at edges of their flat faces, where there is no derivative"
CHOSEN = (
    "the greedy reduction chooses centres for each displacement; the derivative is that of the interpolation with all "
    "centres"
)
HALF_TURNS = (
    "{} wall nodes turn by 180 degrees, where the direction of rotation jumps; the derivative is that on one side"
)
FOLDED = "{} wall nodes have faces that are folded onto each other, where normals jump"
LARGEST = "{} sources share the largest displacement, which sets alpha; the mean of their derivatives is taken"
BETWEEN = (
    "{} wall nodes are equally far from two nodes across a closing gap, whose direction jumps from one to the other"
)
_HALF_TURN = 1e-6
"""Relative difference from half a turn."""


@dataclass(frozen=True)
class PatchMotion:
    """The motion of a moving boundary entry, as evaluated.

    ``max_displacement`` and ``mean_displacement`` (grid length unit) are those of its nodes. ``max_rotation_deg`` is
    the largest rotation of its surface (degrees; above 180 only where other parts of the surface turn by less), and
    ``rotation_axis`` the right-handed unit axis of that rotation, zero without a rotation.
    """

    boundary: str
    max_displacement: float
    mean_displacement: tuple[float, float, float]
    max_rotation_deg: float
    rotation_axis: tuple[float, float, float] = (0.0, 0.0, 0.0)


def patch_motions(problem: Problem, displacement: FloatArray) -> tuple[PatchMotion, ...]:
    """The motion of every moving boundary entry for a displacement (n_unique, 3) of all face nodes."""
    sources = problem.source_numbers
    _, turns = problem.rotations.of(displacement[sources])
    names = [patch.name for patch in problem.boundary.patches if patch.kind is Kind.MOVING]
    found = []
    for name, (nodes, _) in zip(names, problem.boundary.movers, strict=True):
        moved = displacement[nodes]
        x, y, z = (total(moved) / len(moved)).tolist()
        largest = float(lengths(moved).max(initial=0.0))
        # A zero axis if nothing turns.
        turn, axis = turns[np.searchsorted(sources, nodes)], (0.0, 0.0, 0.0)
        angle = float(lengths(turn).max(initial=0.0))
        if angle > 0.0:
            u, v, w = (turn[int(np.argmax(lengths(turn)))] / angle).tolist()
            axis = (u, v, w)
        found.append(PatchMotion(name, largest, (x, y, z), math.degrees(angle), axis))
    return tuple(found)


def largest_rotation(problem: Problem, displacement: FloatArray) -> float:
    """Largest rotation of a moving wall relative to the fixed boundary, or to the mean if nothing is fixed (degrees),
    for a displacement (n_sources, 3)."""
    _, turn = problem.rotations.of(displacement)
    if not (problem.boundary.kind[problem.source_numbers] == Kind.FIXED).any():
        turn = turn - turn.mean(axis=0)
    return math.degrees(float(lengths(turn).max()))


def warn_of_rotation(problem: Problem, displacement: FloatArray, limit: float, what: str, advice: str) -> list[str]:
    """A warning if walls turn by more than ``limit`` degrees; ``what`` happens then, ``advice`` on what to do."""
    angle = largest_rotation(problem, displacement)
    if angle <= limit:
        return []
    text = f"walls turn by up to {angle:.0f} degrees; beyond about {limit:.0f}, {what}: {advice}"
    return [Notice(text, "rotation of walls")]


def warn_of_alpha(full: float, cap: float) -> list[str]:
    """A warning if alpha by eq. 18 (``full``) exceeds ``cap``."""
    if full <= cap:
        return []
    steps = math.ceil(full / cap)
    text = (
        f"eq. 18 gives alpha = {full:.3g} for so large a step; values above {cap} cross cells, so {cap} is used. Take "
        f"at least {steps} steps (--steps {steps}), or set method.idw.alpha"
    )
    return [Notice(text, "alpha above its largest value")]


def warn_of_radius(radius: float, terms: FloatArray, values: FloatArray) -> list[str]:
    """A warning if a support radius is too small for a step.

    A compact function falls from 1 to 0 within its radius R with a slope of up to about 2/R, so a displacement of more
    than R/2 folds the space around the centre. The linear part of the displacement does not count, as the polynomial
    ``terms`` (n, q) reproduce it.
    """
    linear = terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    largest = float(np.linalg.norm(values - linear, axis=1).max())
    if 2.0 * largest <= radius:
        return []
    text = (
        f"the support radius {radius:.4g} is less than twice the largest displacement {largest:.4g} of a step (linear "
        f'part removed): cells will cross around it; use a larger method.rbf.radius, or "auto", or more steps'
    )
    return [Notice(text, "support radius")]


def warn_of_coarse_tolerance(tolerance: FloatArray, height: FloatArray, corrected: bool) -> str | None:
    """A warning if eps_g, as lengths (n,), exceeds first-cell heights (n,) at moving nodes."""
    coarse = tolerance > height
    if not coarse.any():
        return None
    worst = int(np.argmax(tolerance / height))
    rest = "the correction moves them by as much" if corrected else "they miss their position by as much"
    return (
        f"greedy_tolerance is coarser than the first cell at {int(coarse.sum()):,} of {len(height):,} moving nodes (up "
        f"to {tolerance[worst]:.3g}, the cell is {height[worst]:.3g} high; {rest}): wall cells may invert; use a "
        f'smaller tolerance, or greedy_error = "first-cell"'
    )


def tied(size: FloatArray, owner: IntArray) -> int:
    """Number of sources whose ``size`` (n,) is the largest, zero if it is one; images of an ``owner`` count once."""
    found = len(np.unique(owner[largest(size)]))
    return found if found > 1 else 0


def half_turns(turn: FloatArray, owner: IntArray) -> int:
    """Number of sources that turn by 180 degrees; ``turn`` (n,) are the angles of their images, radians."""
    return len(np.unique(owner[np.abs(turn - np.pi) < _HALF_TURN * np.pi]))


def reason_of(kinks: Kinks) -> str:
    """All of them in words; empty if there are none."""
    return "; ".join(text.replace("{}", f"{count:,}", 1) for text, count in kinks.items())
