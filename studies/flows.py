"""Motions for which a valid grid is known to exist: a random smooth flow carries all nodes of a grid.

The velocity is a sum of vortices and jets without divergence and of weak sources, each with a Gaussian envelope. Its
flow maps space onto itself without folding; where the cells are too coarse to follow, the verdict on the flowed grid
itself says so and a gentler flow is taken.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import Follow, Motion
from meshdeform_core.boundary.tables import Matching
from meshdeform_core.deform import Case
from meshdeform_core.grid import FloatArray, Grid, Side
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.topology import Topology, find_topology, side_nodes
from meshdeform_core.methods import Options
from meshdeform_core.numerics.jit import kernel
from meshdeform_core.quality import Original
from meshdeform_core.quality.validity import judge
from meshdeform_formats.grids import read_grid
from meshdeform_samples import load

T = TypeVar("T")

SAMPLES = {
    "square": 41,
    "airfoil": 101,
    "beam": 80,
    "splitter-plate": 8,
    "hemisphere": 12,
    "cascade": 16,
    "wing": 12,
    "valve": 16,
}
"""Samples with their sizes."""

THIRD_PARTY = (
    "shear_3blk_2d.p2dfmt",
    "nak_a_141.p3dfmt",
    "backstep5_4levdn.p3dbin",
    "cylinder_ring_4blk.x",
    "717_wl_L2.cgns",
    "StructuredGrid.vts",
    "SampleStructGrid.vtk",
)
"""Files in the folder that ``MESHDEFORM_GRIDS`` names (default: ``../shared/grids`` beside the repository)."""

_MODES, _TIME_STEPS, _GENTLER, _TRIALS = 6, 48, 0.8, 20
# Largest rotation rate of a vortex, displacement of a jet relative to its radius, and rate of expansion of a source.
_SPIN, _JET, _SOURCE = np.deg2rad(100.0), 0.7, 0.25


@dataclass(frozen=True)
class Terrain:
    """A grid with the data its flows need.

    ``extent`` is the size of the region around which the boundary nodes cluster; ``normal`` is the axis of a grid that
    is plane or extruded, else ``None``.
    """

    name: str
    grid: Grid
    topology: Topology
    original: Original
    extent: float
    normal: int | None


@dataclass(frozen=True)
class Flow:
    """A steady velocity field; all arrays have a row per mode. ``normal``: axis without motion, if any."""

    center: FloatArray
    radius: FloatArray
    spin: FloatArray
    jet: FloatArray
    source: FloatArray
    normal: int | None

    def carry(self, points: FloatArray, time: float = 1.0) -> FloatArray:
        """Where the flow has brought ``points`` (n, 3) at ``time``: classical Runge-Kutta steps."""
        moved = points.copy()
        planar = -1 if self.normal is None else self.normal
        _carry(moved, self.center, self.radius, self.spin, self.jet, self.source, planar, time / _TIME_STEPS)
        return moved


@kernel
def _carry(points, center, radius, spin, jet, source, normal, step):
    rates = np.zeros((4, 3))
    at = np.empty(3)
    for n in range(points.shape[0]):
        for _ in range(_TIME_STEPS):
            for stage in range(4):
                share = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5
                for d in range(3):
                    at[d] = points[n, d] + share * step * rates[stage - 1, d]
                _velocity(at, center, radius, spin, jet, source, normal, rates[stage])
            for d in range(3):
                points[n, d] += step / 6.0 * (rates[0, d] + 2.0 * rates[1, d] + 2.0 * rates[2, d] + rates[3, d])


@kernel
def _velocity(x, center, radius, spin, jet, source, normal, out):
    """Sum of the modes; with ``normal`` >= 0 a plane field that does not change along that axis."""
    out[:] = 0.0
    y = np.empty(3)
    # The curl of envelope (jet x y) over this number is a jet that begins with the velocity ``jet``.
    turns = 2.0 if normal < 0 else 1.0
    for m in range(center.shape[0]):
        for d in range(3):
            y[d] = 0.0 if d == normal else x[d] - center[m, d]
        square = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
        along = y[0] * jet[m, 0] + y[1] * jet[m, 1] + y[2] * jet[m, 2]
        scale = 1.0 / (turns * radius[m] ** 2)
        envelope = math.exp(-0.5 * square / radius[m] ** 2)
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            swirl = spin[m, e] * y[f] - spin[m, f] * y[e]
            stream = jet[m, d] - scale * (jet[m, d] * square - y[d] * along)
            out[d] += envelope * (swirl + stream + source[m] * y[d])


def grids_folder() -> Path:
    """Where the third-party grids lie."""
    return Path(os.environ.get("MESHDEFORM_GRIDS", Path(__file__).parents[2] / "shared" / "grids"))


def without_missing_flap(motions: Mapping[str, T]) -> dict[str, T]:
    """Motions by name, those of Turek and Hron's flap only where its grid is."""
    found = (grids_folder() / "turek").is_dir()
    return {name: motion for name, motion in motions.items() if found or not name.startswith("flap")}


def available() -> list[str]:
    """Names of the grids available here."""
    return [*SAMPLES, *(name for name in THIRD_PARTY if (grids_folder() / name).is_file())]


def terrain(name: str) -> Terrain:
    """A sample at its small size, or a third-party grid."""
    grid = load(name).generate(SAMPLES[name]) if name in SAMPLES else read_grid(grids_folder() / name)
    topology = find_topology(grid)
    nodes = np.unique(topology.quads.corners[topology.external])
    boundary = grid.points[topology.first[nodes]]
    distance = np.linalg.norm(boundary - np.median(boundary, axis=0), axis=1)
    return Terrain(name, grid, topology, Original(grid, topology), 2.0 * float(np.median(distance)), _normal(grid))


def _normal(grid: Grid) -> int | None:
    """The axis that the grid is extruded along, or that a 2-D grid is normal to."""
    normal = plane_normal(grid)
    if normal is not None:
        return int(np.argmax(np.abs(normal)))
    return next((axis for axis in range(3) if _extruded(grid, axis)), None)


def _extruded(grid: Grid, axis: int) -> bool:
    """All blocks reach from one plane to another one, and their sections do not change on the way."""
    low, high = grid.points[:, axis].min(), grid.points[:, axis].max()
    round_off = 1e-9 * np.ptp(grid.points, axis=0).max()
    others = [d for d in range(3) if d != axis]
    for b in range(grid.n_blocks):
        x = grid.block(b)
        along = [i for i in range(3) if np.ptp(x[..., others], axis=i).max() < round_off]
        level = [
            i for i in along
            if np.ptp(np.moveaxis(x[..., axis], i, 0).reshape(x.shape[i], -1), axis=1).max() < round_off
        ]  # fmt: skip
        if not level or x[..., axis].min() - low > round_off or high - x[..., axis].max() > round_off:
            return False
    return True


def flow_normal(place: Terrain, seed: int) -> int | None:
    """The axis without motion: that of plane grids and single layers; of thicker slices at every other seed."""
    thick = place.normal is not None and min(n for shape in place.grid.shapes for n in shape) > 2
    return None if thick and seed % 2 else place.normal


def random_flow(place: Terrain, seed: int, gentleness: float = 1.0) -> Flow:
    """The flow of a seed around the boundaries of a grid."""
    random, normal = np.random.default_rng(seed), flow_normal(place, seed)
    nodes = np.unique(place.topology.quads.corners[place.topology.external])
    center = place.grid.points[place.topology.first[random.choice(nodes, _MODES)]]
    radius = place.extent * random.uniform(0.3, 1.0, _MODES)
    strength = gentleness * random.uniform(0.3, 1.0) * random.uniform(0.3, 1.0, _MODES)
    spin, jet = (_directions(random, normal) * strength[:, None] for _ in range(2))
    if normal is not None:
        spin = np.zeros((_MODES, 3))
        spin[:, normal] = strength * random.choice((-1.0, 1.0), _MODES)
    source = strength * random.uniform(-_SOURCE, _SOURCE, _MODES)
    return Flow(center, radius, _SPIN * spin, _JET * radius[:, None] * jet, source, normal)


def _directions(random: np.random.Generator, normal: int | None) -> FloatArray:
    vectors = random.standard_normal((_MODES, 3))
    if normal is not None:
        vectors[:, normal] = 0.0
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def flowed(place: Terrain, seed: int) -> tuple[FloatArray, float]:
    """Nodes (n_nodes, 3) that a flow has carried to a valid grid, and how gentle it had to be made (1: not at all).

    Raises
    ------
    RuntimeError
        When no flow of this seed, however gentle, leaves the grid valid.
    """
    gentleness = 1.0
    for _ in range(_TRIALS):
        points = random_flow(place, seed, gentleness).carry(place.grid.points)
        if not judge(place.original, points).invalid.size:
            return points, gentleness
        gentleness *= _GENTLER
    raise RuntimeError(f"{place.name}, flow {seed}: even {gentleness:.1%} of it makes cells invalid")


def case_of(place: Terrain, seed: int, points: FloatArray, options: Options) -> Case:
    """The case in which the boundary of a grid goes where it lies in ``points`` (n_nodes, 3).

    All outside faces are prescribed, except that the two planes that bound a plane flow slide.
    """
    given, sliding, normal = [], [], flow_normal(place, seed)
    three = place.grid.dimension == 3
    for block, name in enumerate(place.grid.names):
        for side in Side:
            if not place.topology.external[place.topology.quads.of_side(block, side)].any():
                continue
            nodes = side_nodes(place.grid, block, side)
            flat = three and normal is not None and np.ptp(place.grid.points[nodes, normal]) == 0.0
            (sliding if flat else given).append(f"{name}.{side.label}")
    motion = Motion((Follow(place.grid.moved(points), Matching()),), {})
    specs = [BoundarySpec("given", tuple(given), Kind.MOVING, None, motion)]
    if sliding:
        specs.append(BoundarySpec("planes", tuple(sliding), Kind.SLIP))
    return Case(tuple(specs), method=options)
