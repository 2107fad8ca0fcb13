"""Problems and methods that many tests share."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from grids import frame

from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.boundary.classification import prescribed_displacement
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import IDW, RBF, TFI, Options, Problem, make_method

ALL_METHODS: dict[str, Options] = {
    "tfi": Options("tfi"),
    "rbf-tps": Options("rbf"),
    **{
        f"rbf-{basis}": Options("rbf", rbf=RBF(basis=basis, radius=6.0))
        for basis in ("wendland-c0", "wendland-c2", "ctps-c1", "ctps-c2a", "ctps-c2b")
    },
    "rbf-krylov": Options("rbf", rbf=RBF(solver="krylov", tolerance=1e-13)),
    "rbf-tfi": Options("rbf-tfi"),
    "idw-rbf": Options("idw-rbf"),
    "idw-lie": Options("idw"),
    "idw-none": Options("idw", idw=IDW(rotation="none")),
    "idw-quaternion": Options("idw", idw=IDW(rotation="quaternion")),
    "idw-division": Options("idw", idw=IDW(rotation="division", divisions=8)),
    "idw-blend": Options("idw", idw=IDW(rotation="blend")),
    "idw-shepard": Options("idw", idw=IDW(weights="shepard", p_moving=4, p_fixed=3)),
    "idw-tfi": Options("idw-tfi"),
    "idw-tfi-cut": Options("idw-tfi", tfi=TFI(max_cells=2)),
}

REPEATED = {"rbf-wendland-c0", "rbf-ctps-c1", "rbf-ctps-c2a", "rbf-ctps-c2b"}
"""Methods that differ from others by a formula only, which has tests of its own."""
FEW = sorted({"idw-quaternion", *{each.name: name for name, each in reversed(ALL_METHODS.items())}.values()})
"""The first of each method of the catalogue, for tests that take long, and one with a rotation of its own."""
NO_ROTATION, FRAME_DEPENDENT = {"idw-none"}, {"idw-quaternion", "idw-division"}
"""What methods do not promise (spec section 10): rotations of the whole boundary; results that no origin changes."""


def every(names: Iterable[str], repeated: Iterable[str] = REPEATED) -> pytest.MarkDecorator:
    """Runs a test with every method; with those that repeat others in the long test run only."""
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=pytest.mark.slow if name in repeated else ()) for name in names]
    )


def constant(x: float, y: float, z: float) -> Motion:
    return formulas(str(float(x)), str(float(y)), str(float(z)))


def formulas(x: str, y: str, z: str) -> Motion:
    parts = [expression(text, {"x", "y", "z", "t"}) for text in (x, y, z)]
    return Motion((Displace((parts[0], parts[1], parts[2])),), {})


def turning(
    angle: float, axis: tuple[float, float, float] = (0, 0, 1), center: tuple[float, ...] = (0, 0, 0)
) -> Motion:
    c = [expression(float(v), ()) for v in center]
    return Motion((Rotate(expression(angle, {"t"}), axis, (c[0], c[1], c[2])),), {})


INNER = "abs(x) < 0.51 and abs(y) < 0.51"
STILL = constant(0, 0, 0)


def body_specs(motion: Motion, span: Kind = Kind.SLIP) -> list[BoundarySpec]:
    """The bar of ``frame`` moves, the outside stays, the span slides."""
    near = expression(INNER, {"x", "y", "z"})
    return [
        BoundarySpec("body", ("*.i*", "*.j*"), Kind.MOVING, near, motion),
        BoundarySpec("span", ("*.kmin", "*.kmax"), span),
    ]


def everything_moves(motion: Motion = STILL) -> list[BoundarySpec]:
    return [BoundarySpec("all", ("*",), Kind.MOVING, None, motion)]


def problem_of(grid: Grid | None = None, specs: list[BoundarySpec] | None = None) -> Problem:
    grid = frame() if grid is None else grid
    topology = find_topology(grid)
    boundary = classify(grid, topology, specs or everything_moves(), {})
    return Problem(grid, topology, boundary)


def prescribed(problem: Problem) -> np.ndarray:
    """The displacement (n_unique, 3) that the boundary prescribes."""
    return prescribed_displacement(problem.grid, problem.topology, problem.boundary)


def told(problem: Problem) -> np.ndarray:
    """That of the sources (n_sources, 3)."""
    return prescribed(problem)[problem.source_numbers]


def inner_nodes(problem: Problem) -> np.ndarray:
    return np.setdiff1d(np.arange(problem.grid.n_nodes), problem.topology.face_nodes)


def apply(options: Options, problem: Problem, motion: Callable[[np.ndarray], np.ndarray] | np.ndarray) -> np.ndarray:
    """Displacement of all nodes for a motion of the sources, given as a function of their coordinates."""
    displacement = motion(problem.source_points) if callable(motion) else motion
    return make_method(options).prepare(problem).apply(displacement)


def sphere(n: int) -> np.ndarray:
    """Nearly evenly spread points of a unit sphere (golden spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)


def graded_plane(n: int = 38) -> np.ndarray:
    """A plane patch clustered towards one edge, first spacing 1/400 of the largest, as beside a wall."""
    u = (np.geomspace(1.0, 400.0, n) - 1.0) / 399.0
    x, y = np.meshgrid(u, np.linspace(0.0, 1.0, n), indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def bend(x: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(2 * x[:, 1]), np.cos(x[:, 0]) * x[:, 2], np.exp(x[:, 0])], axis=1)


SETS = {
    "sphere": sphere(1500),
    "graded-plane": graded_plane(),
    "two-scales": np.concatenate([sphere(900), 20.0 + 5.0 * sphere(600)]),
    "curve": np.stack([np.cos(np.arange(1200) / 190), np.sin(np.arange(1200) / 190), np.zeros(1200)], axis=1),
    "line": np.linspace(0, 1, 1000)[:, None] * np.array([1.0, 2.0, -1.0]),
}
