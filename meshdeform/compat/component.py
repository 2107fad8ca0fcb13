"""Zones that move together, the whole grid or one component of overset grids, and a solver's surface on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from meshdeform_core.errors import CaseError, GridError, MotionError
from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray, Patch
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, Topology, find_topology, quads_of_patches
from meshdeform_core.grid.windows import rectangles
from meshdeform_core.wording import vector

from ..grid import wrapped
from ..mesh import Linearisation, Mesh, Repeated
from ..step import Step
from ..tasks import options_of, prepare
from .options import Options

SURFACE = "surface"
_AGREE, _DISAGREE = 1e-6, 0.1
"""Copies of a point agree if they are closer than the first fraction of the local edge; farther apart than the second
fraction is an error."""


@dataclass(frozen=True)
class Definition:
    """The surface that a solver defines.

    Attributes
    ----------
    points : (n, 3) undeformed; points may repeat
    faces : (n_faces, 4) their corners; triangles repeat the last one
    zone : (n_faces,) number of the zone from 0; -1 if not given
    """

    points: FloatArray
    faces: IntArray
    zone: IntArray

    @classmethod
    def of(cls, points: ArrayLike, conn: ArrayLike, sizes: ArrayLike, zones: ArrayLike | None) -> Definition:
        """From the arguments of ``setSurfaceDefinition``, whose shapes and numbers are checked."""
        pts = np.array(points, dtype=np.float64).reshape(-1, 3)
        count, flat = np.asarray(sizes, dtype=np.int64).ravel(), np.asarray(conn, dtype=np.int64).ravel()
        if not np.isin(count, (3, 4)).all() or count.sum() != len(flat):
            raise MotionError(
                f"faceSizes sum up to {count.sum()}, conn has {len(flat)} entries; expected faces of 3 or 4 corners"
            )
        if len(flat) and (flat.min() < 0 or flat.max() >= len(pts)):
            raise MotionError(f"conn has {flat.min()} to {flat.max()}; expected 0 to {len(pts) - 1}, rows of pts")
        last = np.cumsum(count) - 1
        at = np.minimum((last - count + 1)[:, None] + np.arange(4), last[:, None])
        if zones is None:
            zone = np.full(len(count), -1)
        else:
            zone = np.asarray(zones, dtype=np.int64).ravel() - 1
        if len(zone) != len(count):
            raise MotionError(f"{len(zone)} cgnsBlockIDs for {len(count)} faces; expected one each")
        return cls(pts, flat[at], zone)


class Zones:
    """Some zones of a grid with their topology, before it is known what moves."""

    def __init__(self, grid: Grid, zones: IntArray, options: Options):
        self.options, self.zones = options, zones
        whole = len(zones) == grid.n_blocks
        rows = [np.arange(grid.offsets[z], grid.offsets[z + 1]) for z in zones]
        self.rows = slice(None) if whole else np.concatenate(rows)
        place = {int(zone): number for number, zone in enumerate(zones)}
        windows = [
            tuple(replace(each, block=place[each.block]) for each in patch.windows if each.block in place)
            for patch in grid.patches
        ]
        # Always double precision, even if the file is in single precision, as derivatives are checked with small steps.
        self.grid = Grid(
            grid.points if whole else grid.points[self.rows],
            tuple(grid.shapes[z] for z in zones),
            tuple(grid.names[z] for z in zones),
            patches=tuple(replace(patch, windows=own) for patch, own in zip(grid.patches, windows, strict=True) if own),
        )
        self.topology: Topology = find_topology(self.grid)

    def wall_quads(self) -> IntArray:
        """The outside face quads that the options select as the surface; by default those of declared walls."""
        families = self.options["specifiedSurfaces"]
        if families is None:
            chosen = [patch for patch in self.grid.patches if patch.bc_type.lower().startswith("bcwall")]
        else:
            chosen = _of_families(self.grid, families, "specifiedSurfaces")
        if not chosen:
            raise CaseError(
                "the file declares no wall (BCWall...); expected specifiedSurfaces, or a call of setSurfaceDefinition"
            )
        quads = np.unique(quads_of_patches(self.topology.quads, chosen)[0])
        return np.asarray(quads[self.topology.external[quads]])

    def symmetry(self) -> list[IntArray]:
        """Face quads of each symmetry plane."""
        planes, families = self.options["symmetryPlanes"], self.options["symmetrySurfaces"]
        if planes is not None:
            outside, tolerance = np.flatnonzero(self.topology.external), self.options["symmTol"]
            found: list[IntArray] = []
            corners = self.grid.points[self.topology.first[self.topology.quads.corners[outside]]]
            for point, normal in (map(np.asarray, plane) for plane in planes):
                height = np.abs((corners - point) @ (normal / np.linalg.norm(normal))).max(axis=1)
                found.append(np.asarray(outside[height <= tolerance]))
                if not found[-1].size:
                    raise CaseError(
                        f"symmetryPlanes: no outside face lies within symmTol = {tolerance:g} of the plane "
                        f"through {vector(point)} normal to {vector(normal)}; the nearest is {height.min():.3g} away"
                    )
            return found
        if families is not None:
            chosen = _of_families(self.grid, families, "symmetrySurfaces")
        else:
            chosen = [patch for patch in self.grid.patches if patch.bc_type.lower().startswith("bcsymmetry")]
        return [quads_of_patches(self.topology.quads, [patch])[0] for patch in chosen]

    def match(self, definition: Definition) -> tuple[BoolArray, IntArray, tuple[IntArray, IntArray]]:
        """Find the faces of a definition on these zones, and those without a zone, among the outside faces.

        Returns which faces (n_faces,) were found, their face quads, ascending, and pairs: the points of these faces
        with their unique nodes. Points match nodes closer than ``RELATIVE_TOLERANCE`` times the shortest edge there.
        """
        topology = self.topology
        candidates = np.flatnonzero((definition.zone < 0) | np.isin(definition.zone, self.zones))
        outside = np.flatnonzero(topology.external)
        nodes = np.unique(topology.quads.corners[outside])
        points = np.unique(definition.faces[candidates])
        distance, nearest = cKDTree(self.grid.points[topology.first[nodes]]).query(definition.points[points])
        node = np.full(len(definition.points), -1, dtype=np.int64)
        node[points] = nodes[nearest]
        node[points[distance > RELATIVE_TOLERANCE * topology.edge[node[points]]]] = -1
        corners = node[definition.faces[candidates]]
        known = (corners >= 0).all(axis=1)
        # A number for each set of corners, equal for equal sets; triangles repeat a corner.
        ordered = np.sort(np.concatenate([corners[known], topology.quads.corners[outside]]), axis=1)
        ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
        keys = np.unique(np.sort(ordered, axis=1), axis=0, return_inverse=True)[1].ravel()
        asked, offered = keys[: known.sum()], keys[known.sum() :]
        found = np.zeros(len(definition.faces), dtype=bool)
        found[candidates[known]] = np.isin(asked, offered)
        used = np.unique(definition.faces[found])
        return found, outside[np.isin(offered, asked)], (used, node[used])

    def patch(self, name: str, quads: IntArray, bc_type: str) -> Patch:
        """A patch of exactly these face quads."""
        label = np.full(len(self.topology.partner), -1)
        label[quads] = 0
        return Patch(name, tuple(rectangles(self.grid, self.topology.quads, label).windows()), bc_type=bc_type)


class Component:
    """Zones, the surface that moves them, and the result of the last displacement.

    ``point`` and ``node`` are pairs: a point of the whole surface, and its unique node. If several copies of a point
    belong to a node, it moves by their mean.
    """

    def __init__(self, zones: Zones, quads: IntArray, pairs: tuple[IntArray, IntArray]):
        self.rows = zones.rows
        self._mesh = _mesh(zones, quads)
        self._repeated = Repeated(self._mesh, 1, zones.options["repair"])
        numbers, topology = self._mesh.numbers, self._mesh.setup.topology
        self.point, node = pairs
        self._row = np.searchsorted(numbers, node)
        if not np.array_equal(numbers[self._row], node):
            raise GridError("points of the surface lie on no face of it; expected every point in a face")
        copies, count = np.bincount(self._row, minlength=len(numbers)), len(self._row)
        self._mean = csr_array((1.0 / copies[self._row], (self._row, np.arange(count))), (len(numbers), count))
        self._first = np.full(len(numbers), -1, dtype=np.int64)
        self._first[self._row[::-1]] = self.point[::-1]
        every = np.searchsorted(numbers, topology.number)
        at = np.flatnonzero(numbers[np.minimum(every, len(numbers) - 1)] == topology.number)
        wall = topology.face_nodes[at]
        self._wall, self._wall_row = wall if isinstance(self.rows, slice) else self.rows[wall], every[at]
        self._positions = self._mesh.points
        self._step: Step | None = None

    @property
    def points(self) -> FloatArray:
        """Undeformed positions (n, 3) of the nodes that the surface moves, each once."""
        return self._mesh.points

    def warp(self, surface: FloatArray) -> tuple[Step, float]:
        """Deform for the positions (n, 3) of all points.

        Returns the step, and the largest distance between copies of a point relative to the local edge.
        """
        start = surface[self._first]
        apart = surface[self.point] - start[self._row]
        edge = self._mesh.setup.topology.edge[self._mesh.numbers]
        gap = np.linalg.norm(apart, axis=1) / edge[self._row]
        worst = int(np.argmax(gap))
        if gap[worst] > _DISAGREE:
            raise MotionError(
                f"copies of the surface point {vector(self.points[self._row[worst]])} are {gap[worst]:.3g} edges "
                f"apart: {vector(start[self._row[worst]])} and {vector(surface[self.point[worst]])}; "
                f"expected the same"
            )
        # Exactly where they were set, if copies agree.
        self._positions = start + self._mean @ apart
        self._step = self._repeated.step(self._positions - self.points)
        return self._step, float(gap[worst]) if gap[worst] > _AGREE else 0.0

    def put(self, whole: FloatArray) -> None:
        """Write the deformed nodes into an array (n_nodes, 3) of all zones; wall nodes are exactly where they were
        set."""
        if self._step is not None:
            whole[self.rows] = self._step.result.grid.points
            whole[self._wall] = self._positions[self._wall_row]

    def derivative(self) -> Linearisation:
        """The derivative at the last displacement."""
        return self._repeated.derivative(self._positions - self.points, lambda _: None)

    def forward(self, change: FloatArray) -> FloatArray:
        """Change (n, 3) of the nodes of these zones for a ``change`` of all points."""
        moved = self._mean @ change[self.point]
        return np.asarray(self.derivative().operator.matvec(moved.ravel())).reshape(-1, 3)

    def reverse(self, gradient: FloatArray, total: FloatArray) -> None:
        """Transpose of :meth:`forward`: add to ``total`` the gradient of all points from that (n_nodes, 3) of all
        nodes."""
        found = np.asarray(self.derivative().operator.rmatvec(gradient[self.rows].ravel())).reshape(-1, 3)
        np.add.at(total, self.point, self._mean.T @ found)


def _mesh(zones: Zones, quads: IntArray) -> Mesh:
    """The mesh whose surface ``quads`` move: symmetry planes mirror them, all other outside nodes are free."""
    mirrors = [zones.patch(f"symmetry{n}", each, "BCSymmetryPlane") for n, each in enumerate(zones.symmetry(), 1)]
    patches = (zones.patch(SURFACE, quads, "BCWall"), *mirrors)
    held = wrapped(replace(zones.grid, patches=patches))
    rest = zones.topology.external.copy()
    rest[np.concatenate([quads, quads_of_patches(zones.topology.quads, mirrors)[0]])] = False
    mesh = prepare(
        held,
        moving=[SURFACE],
        symmetry=[patch.name for patch in mirrors] or None,
        free={"free": ["*"]} if rest.any() else None,
        method="idw",
    )
    # The method's L_def depends on the sources, which are known only after the set-up.
    setup = mesh.setup
    length = float(np.linalg.norm(setup.problem.source_points - setup.problem.centroid, axis=1).max())
    case = replace(setup.case, method=options_of(zones.options.method(length)))
    return Mesh(replace(setup, case=case), False, mesh.ranks, None)


def _of_families(grid: Grid, names: list[str], option: str) -> list[Patch]:
    words = [{patch.family.lower(), patch.name.lower()} for patch in grid.patches]
    for name in names:
        if not any(name.lower() in each for each in words):
            known = sorted({patch.family or patch.name for patch in grid.patches})
            raise CaseError(f"{option}: no family {name!r}; expected some of {', '.join(known) or '(none declared)'}")
    wanted = {name.lower() for name in names}
    return [patch for patch, each in zip(grid.patches, words, strict=True) if each & wanted]


def require_found(definition: Definition, times: IntArray) -> None:
    """Require that every face lies on exactly one grid; ``times`` (n_faces,): on how many it was found."""
    for number, what, advice in (
        (0, "are not faces on the outside of the grid", "the undeformed surface of the same grid, in its length unit"),
        (2, "lie on several components", "cgnsBlockIDs, which tell the zone of each face"),
    ):
        bad = np.flatnonzero(np.minimum(times, 2) == number)
        if bad.size:
            center = definition.points[definition.faces[bad[0]]].mean(axis=0)
            raise GridError(
                f"{bad.size:,} of {len(times):,} faces of the surface {what}, the first around "
                f"{vector(center)}; expected {advice}"
            )


def rows_of_file(grid: Grid, numbers: IntArray) -> IntArray:
    """Rows of ``grid.points`` of nodes (n,) numbered in the order of the file, i fastest in each zone."""
    zone = np.searchsorted(grid.offsets, numbers, side="right") - 1
    ni, nj, nk = np.asarray(grid.shapes, dtype=np.int64).T
    k, rest = np.divmod(numbers - grid.offsets[zone], (ni * nj)[zone])
    j, i = np.divmod(rest, ni[zone])
    return np.asarray(grid.offsets[zone] + (i * nj[zone] + j) * nk[zone] + k)


def rows_of_freedoms(grid: Grid, indices: ArrayLike) -> IntArray:
    """Rows of ``grid.points`` from degrees of freedom (3 n,), which have to be x, y, z of nodes one after another."""
    freedoms = np.asarray(indices)
    if freedoms.size == 0:
        return np.empty(0, dtype=np.int64)
    if freedoms.ndim != 1 or freedoms.dtype.kind not in "iu" or len(freedoms) % 3:
        raise GridError(
            f"indices are {freedoms.shape} {freedoms.dtype}; expected whole numbers (3 n,): x, y, z of n nodes"
        )
    nodes = freedoms[::3].astype(np.int64) // 3
    if not np.array_equal(freedoms.reshape(-1, 3), 3 * nodes[:, None] + np.arange(3)):
        raise GridError("indices are not x, y, z (3 m, 3 m + 1, 3 m + 2) of one node after another")
    if nodes.min() < 0 or nodes.max() >= grid.n_nodes:
        raise GridError(
            f"indices of the nodes {nodes.min()} to {nodes.max()}; the grid has {grid.n_nodes}, numbered from 0"
        )
    return rows_of_file(grid, nodes)
