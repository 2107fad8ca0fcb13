"""What derivatives are tested at: methods, kinds of boundaries, directions."""

import numpy as np
from cases import ALL_METHODS, body_specs, everything_moves, problem_of, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.methods import IDW, Options

# With weights computed anew in every part of a rotation there is no exact derivative.
METHODS = ALL_METHODS | {
    "idw-alpha": Options("idw", idw=IDW(alpha="auto", eta=4.0)),
    "idw-alpha-none": Options("idw", idw=IDW(rotation="none", alpha="auto", eta=4.0)),
    "idw-smoothed": Options("idw", idw=IDW(rotation="blend", smoothing=3)),
    "idw-two-exponents": Options("idw", idw=IDW(weights="shepard", p_moving=4.0)),
    "idw-no-transition": Options("idw", idw=IDW(transition=0, remove_mean=False)),
}


def bulged():
    grid = frame()
    x = grid.points.copy()
    x[:, 2] += 0.15 * np.sin(1.1 * x[:, 0]) * np.cos(0.8 * x[:, 1])
    return grid.moved(x)


KINDS = {
    "slip": lambda: problem_of(frame(), body_specs(turning(10))),
    "symmetry": lambda: problem_of(frame(), body_specs(turning(10), Kind.SYMMETRY)),
    "periodic": lambda: problem_of(frame(), body_specs(turning(10), Kind.PERIODIC)),
    "free": lambda: problem_of(frame(), body_specs(turning(10), Kind.FREE)),
    "curved slip": lambda: problem_of(bulged(), body_specs(turning(10))),
    "all moving": lambda: problem_of(frame(), everything_moves()),
    "plane": lambda: problem_of(frame_2d(6), body_specs(turning(20))[:1]),
    "plane, all moving": lambda: problem_of(frame_2d(4), [BoundarySpec("all", ("*",), Kind.MOVING, None, turning(5))]),
}


def directions(where):
    """Displacement of the moving sources: smooth, and rough changes of it."""
    moving = (where.boundary.kind[where.source_numbers] == Kind.MOVING)[:, None]
    inside = moving * (1.0 if where.plane_normal is None else 1.0 - np.abs(where.plane_normal))
    x = where.source_points
    smooth = 0.1 * np.sin(1.3 * x[:, [1, 0, 2]] + np.arange(3)) * inside
    rough = np.random.default_rng(5).standard_normal(x.shape) * inside
    return smooth, rough
