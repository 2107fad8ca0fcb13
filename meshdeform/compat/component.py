"""Zones that move together, the whole grid or one component of overset grids, and a solver's surface on them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

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

_AGREE, _DISAGREE = 1e-6, 0.1
"""Copies of a point agree if they are closer than the first fraction of the local edge; farther apart than the second
fraction is an error."""


class Definition(NamedTuple):
    """The surface that a solver defines: undeformed ``points`` (n, 3), which may repeat; ``faces`` (n_faces, 4), their
    corners, of which triangles repeat the last one; ``zone`` (n_faces,), its number from 0, -1 if not given."""

    points: FloatArray
    faces: IntArray
    zone: IntArray


def defined(points: ArrayLike, conn: ArrayLike, sizes: ArrayLike, zones: ArrayLike | None) -> Definition:
    """The definition from the arguments of ``setSurfaceDefinition``, whose shapes and numbers are checked."""
    pts = np.array(points, dtype=np.float64).reshape(-1, 3)
    count, flat = np.asarray(sizes, dtype=np.int64).ravel(), np.asarray(conn, dtype=np.int64).ravel()
    if not np.isin(count, (3, 4)).all() or count.sum() != len(flat):
        raise MotionError(
            f"faceSizes sum up to {count.sum()}, conn has {len(flat)} entries; expected faces of 3 or 4 corners"
        )
    if len(flat) and (flat.min() < 0 or flat.max() >= len(pts)):
        raise MotionError(f"conn has {flat.min()} to {flat.max()}; expected 0 to {len(pts) - 1}, rows of pts")
    zone = np.full(len(count), -1) if zones is None else np.asarray(zones, dtype=np.int64).ravel() - 1
    if len(zone) != len(count):
        raise MotionError(f"{len(zone)} cgnsBlockIDs for {len(count)} faces; expected one each")
    last = np.cumsum(count) - 1
    return Definition(pts, flat[np.minimum((last - count + 1)[:, None] + np.arange(4), last[:, None])], zone)


class Component:
    """Zones of a grid that move together, as a grid of their own, with their surface once :meth:`begin` knows it, and
    the result of the last displacement."""

    def __init__(self, grid: Grid, zones: IntArray, options: Options):
        self.options, self.zones = options, zones
        rows = [np.arange(grid.offsets[z], grid.offsets[z + 1]) for z in zones]
        self.rows = slice(None) if len(zones) == grid.n_blocks else np.concatenate(rows)
        place = {int(zone): number for number, zone in enumerate(zones)}
        patches = []
        for patch in grid.patches:
            own = tuple(replace(each, block=place[each.block]) for each in patch.windows if each.block in place)
            patches += [replace(patch, windows=own)] if own else []
        # Always double precision, even if the file is in single precision, as derivatives are checked with small steps.
        self.grid = Grid(
            grid.points[self.rows],
            tuple(grid.shapes[z] for z in zones),
            tuple(grid.names[z] for z in zones),
            patches=tuple(patches),
        )
        self.topology: Topology = find_topology(self.grid)
        self._step: Step | None = None

    def wall_quads(self) -> IntArray:
        """The outside face quads that the options select as the surface; by default those of declared walls."""
        chosen = self._patches_of("specifiedSurfaces", "bcwall")
        if not chosen:
            raise CaseError(
                "the file declares no wall (BCWall...); expected specifiedSurfaces, or a call of setSurfaceDefinition"
            )
        quads = np.unique(quads_of_patches(self.topology.quads, chosen)[0])
        return np.asarray(quads[self.topology.external[quads]])

    def symmetry(self) -> list[IntArray]:
        """Face quads of each symmetry plane."""
        planes = self.options.symmetryPlanes
        if planes is not None:
            outside, tolerance = np.flatnonzero(self.topology.external), self.options.symmTol
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
        chosen = self._patches_of("symmetrySurfaces", "bcsymmetry")
        return [quads_of_patches(self.topology.quads, [patch])[0] for patch in chosen]

    def _patches_of(self, option: str, bc_type: str) -> list[Patch]:
        """The patches of the families or names that an option lists; by default those declared as of a type."""
        patches, names = self.grid.patches, getattr(self.options, option)
        if names is None:
            return [patch for patch in patches if patch.bc_type.lower().startswith(bc_type)]
        wanted, words = {name.lower(): name for name in names}, set[str]()
        for patch in patches:
            words |= {patch.family.lower(), patch.name.lower()}
        if unknown := wanted.keys() - words:
            known = ", ".join(sorted({patch.family or patch.name for patch in patches})) or "(none declared)"
            raise CaseError(f"{option}: no family {wanted[min(unknown)]!r}; expected some of {known}")
        return [patch for patch in patches if wanted.keys() & {patch.family.lower(), patch.name.lower()}]

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

    def _patch(self, name: str, quads: IntArray, bc_type: str) -> Patch:
        """A patch of exactly these face quads."""
        label = np.full(len(self.topology.partner), -1)
        label[quads] = 0
        return Patch(name, tuple(rectangles(self.grid, self.topology.quads, label).windows()), bc_type=bc_type)

    def begin(self, quads: IntArray, point: IntArray, node: IntArray) -> None:
        """Prepare the grid for its surface, the face ``quads``.

        ``point`` and ``node`` (n,) are pairs: a point of the whole surface, and its unique node. If several copies of a
        point belong to a node, it moves by their mean.
        """
        self._mesh = self._mesh_of(quads)
        self._repeated = Repeated(self._mesh, 1, self.options.repair)
        numbers, topology = self._mesh.numbers, self._mesh.setup.topology
        self.point, self._row = point, np.searchsorted(numbers, node)
        if not np.array_equal(numbers[self._row], node):
            raise GridError("points of the surface lie on no face of it; expected every point in a face")
        copies, count = np.bincount(self._row, minlength=len(numbers)), len(self._row)
        self._mean = csr_array((1.0 / copies[self._row], (self._row, np.arange(count))), (len(numbers), count))
        self._first = np.full(len(numbers), -1, dtype=np.int64)
        self._first[self._row[::-1]] = point[::-1]
        every = np.searchsorted(numbers, topology.number)
        at = np.flatnonzero(numbers[np.minimum(every, len(numbers) - 1)] == topology.number)
        wall = topology.face_nodes[at]
        self._wall, self._wall_row = wall if isinstance(self.rows, slice) else self.rows[wall], every[at]
        self._positions = self._mesh.points

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
                f"copies of the surface point {vector(self._mesh.points[self._row[worst]])} are {gap[worst]:.3g} edges "
                f"apart: {vector(start[self._row[worst]])} and {vector(surface[self.point[worst]])}; "
                f"expected the same"
            )
        # Exactly where they were set, if copies agree.
        self._positions = start + self._mean @ apart
        self._step = self._repeated.step(self._positions - self._mesh.points)
        return self._step, float(gap[worst]) if gap[worst] > _AGREE else 0.0

    def put(self, whole: FloatArray) -> None:
        """Write the deformed nodes into an array (n_nodes, 3) of all zones; wall nodes are exactly where they were
        set."""
        if self._step is not None:
            whole[self.rows] = self._step.result.grid.points
            whole[self._wall] = self._positions[self._wall_row]

    def derivative(self) -> Linearisation:
        """The derivative at the last displacement."""
        return self._repeated.derivative(self._positions - self._mesh.points, lambda _: None)

    def forward(self, change: FloatArray) -> FloatArray:
        """Change (n, 3) of the nodes of these zones for a ``change`` of all points."""
        moved = self._mean @ change[self.point]
        return np.asarray(self.derivative().operator.matvec(moved.ravel())).reshape(-1, 3)

    def reverse(self, gradient: FloatArray, total: FloatArray) -> None:
        """Transpose of :meth:`forward`: add to ``total`` the gradient of all points from that (n_nodes, 3) of all
        nodes."""
        found = np.asarray(self.derivative().operator.rmatvec(gradient[self.rows].ravel())).reshape(-1, 3)
        np.add.at(total, self.point, self._mean.T @ found)

    def _mesh_of(self, quads: IntArray) -> Mesh:
        """The mesh whose surface ``quads`` move: symmetry planes mirror them, all other outside nodes are free."""
        mirrors = [self._patch(f"symmetry{n}", each, "BCSymmetryPlane") for n, each in enumerate(self.symmetry(), 1)]
        held = wrapped(replace(self.grid, patches=(self._patch("surface", quads, "BCWall"), *mirrors)))
        rest = self.topology.external.copy()
        rest[np.concatenate([quads, quads_of_patches(self.topology.quads, mirrors)[0]])] = False
        symmetry = [patch.name for patch in mirrors] or None
        free = {"free": ["*"]} if rest.any() else None
        mesh = prepare(held, moving="surface", symmetry=symmetry, free=free, method="idw")
        # The method's L_def depends on the sources, which are known only after the set-up.
        setup = mesh.setup
        length = float(np.linalg.norm(setup.problem.source_points - setup.problem.centroid, axis=1).max())
        case = replace(setup.case, method=options_of(self.options.method_of(length)))
        return Mesh(replace(setup, case=case), False, mesh.ranks, None)


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


def rows_of_freedoms(rows: IntArray, indices: ArrayLike) -> IntArray:
    """Rows of a grid's points from degrees of freedom (3 n,), which have to be x, y, z of nodes one after another;
    ``rows`` (n_nodes,) are those of all nodes in the order of the file."""
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
    if nodes.min() < 0 or nodes.max() >= len(rows):
        raise GridError(
            f"indices of the nodes {nodes.min()} to {nodes.max()}; the grid has {len(rows)}, numbered from 0"
        )
    return np.asarray(rows[nodes])
