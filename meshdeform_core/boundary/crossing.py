"""Motions of the boundary that leave no valid grid, whatever the method: it crosses itself, or inverts cells or tears
faces all of whose nodes are prescribed.

Faces whose nodes all have a prescribed displacement are tested against each other, and against slip and symmetry
faces in their undeformed position. Faces with a common node never count as crossing: thin plates, seams, collapsed
faces and sharp edges are neighbours. Nor do faces that touched or crossed others before they moved, such as those of
abutting blocks with non-matching nodes.

Flat walls that pass through each other along their normals never cross in the strict sense, because their neighbours
end up in the same planes. So every node is shifted by a pseudo-random 1e-7 of its shortest face edge: faces that touch
or overlap then cross somewhere. Walls that have passed each other completely no longer cross; the solid angle of the
whole boundary shows that they lie outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..numerics.arrays import places_among
from ..numerics.geometry.coincidence import connected_rows, distinct
from ..numerics.geometry.crossing import BESIDE, ORDINARY, SLIDING, crossing_faces, near_faces
from ..numerics.geometry.vectors import plane_winding, winding
from ..wording import Notice, counted, vector
from .classification import UNSELECTED, Boundary, Kind
from .tables import edges_at_corners

TOUCH = 1e-7
"""Faces closer than this fraction of their shortest edge count as touching."""

_HALVINGS = 20
_TORN = 0.5
"""Faces are torn where their nodes move apart by more than this share of their distance."""
# How close undeformed faces of abutting blocks are to each other, relative to their shortest edge.
_ABUTTING = 1e-4
# Largest number of connected moving parts tested for lying outside, of samples on each, and their distance to the face.
_PARTS, _PLACES, _INSIDE = 16, 3, 1e-6


@dataclass(frozen=True)
class Crossing:
    """Two ``patches``, by name, or two parts of one, that pass through each other, ``count`` pairs of faces of them;
    ``point`` is in their intersection.

    A fixed face that a moving patch drags along counts as part of that patch.
    """

    patches: tuple[str, str]
    point: tuple[float, float, float]
    count: int

    def __str__(self) -> str:
        one, two = self.patches
        pair = f"{one!r} meets itself" if one == two else f"{one!r} and {two!r} meet"
        place = ", ".join(f"{x:.6g}" for x in self.point)
        return f"{pair} at ({place}) ({counted(self.count, 'pair of faces', 'pairs of faces')})"


@dataclass(frozen=True)
class Contact:
    """A moving boundary does not cross itself up to ``fraction`` of its motion; there the patches in ``crossings``
    meet, those with most faces first."""

    fraction: float
    crossings: tuple[Crossing, ...]

    @property
    def message(self) -> Notice:
        """Warning: which patches meet, where and when."""
        what = str(self.crossings[0]) if self.crossings else "a part of it lies outside the grid"
        verdict = "the moved boundary crosses itself, so no valid grid exists"
        where = " and ".join(self.crossings[0].patches) if self.crossings else "the outer boundary"
        text = f"{verdict}: from {self.fraction:.2%} of the motion onwards {what}"
        return Notice(text, f"no valid grid: crossing of {where}")


class CrossingTest:
    """Tests whether a boundary crosses itself after a displacement (n_unique, 3), by its faces (m, 4) between unique
    nodes, as far as their position is known. Everything independent of the displacement is computed once.

    A 2-D grid is given a thickness: its edges become strips. ``nodes`` (n,) are the unique numbers of the corners of
    the faces, ascending, ``points`` (n, 3), in 2-D (2 n, 3) of both sides of the strips, are undeformed and ``edge``
    the shortest edge of a face at each; ``quads`` (m,) are numbers of the faces in the topology, ``role`` (m,) is
    ``ORDINARY``, ``BESIDE`` or ``SLIDING``.
    """

    def __init__(self, grid: Grid, topology: Topology, boundary: Boundary):
        self._grid, self._topology, self._boundary = grid, topology, boundary
        self._normal = plane_normal(grid)
        self._size = float(np.ptp(grid.nodes.at(topology.first), axis=0).max())
        kind, corners = boundary.quad_kind, topology.quads.corners
        sliding = np.isin(kind, (Kind.SLIP, Kind.SYMMETRY))
        self.quads = np.flatnonzero((kind >= Kind.FIXED) & boundary.known[corners].all(axis=1) | sliding)
        self.nodes = distinct(corners[self.quads], topology.n_unique)
        self.points = grid.nodes.at(topology.first[self.nodes])
        local = places_among(self.nodes, topology.n_unique).astype(corners.dtype)
        self.faces = local[corners[self.quads]]
        on_slip = np.zeros(topology.n_unique, dtype=bool)
        on_slip[corners[sliding]] = True
        self.role = np.where(on_slip[corners[self.quads]].any(axis=1), BESIDE, ORDINARY).astype(np.int8)
        self.role[sliding[self.quads]] = SLIDING
        self.edge = edges_at_corners(self.points, self.faces)[0]
        if self._normal is not None:
            thickness, n = self.edge[np.isfinite(self.edge)].max(), len(self.points)
            self.points = np.concatenate([self.points, self.points + thickness * self._normal])
            self.faces = np.concatenate([self.faces, self.faces[:, ::-1] + n], axis=1)
            self.edge = np.tile(self.edge, 2)
        # Of a node the same whichever others are on the surface.
        sides, source = len(self.points) // len(self.nodes), np.random.default_rng(0)
        directions = (source.uniform(-1.0, 1.0, (topology.n_unique, 3))[self.nodes] for _ in range(sides))
        self._directions = np.concatenate(list(directions))

    def crossings(self, displacement: FloatArray, gap: float = 0.0) -> tuple[Crossing, ...]:
        """Patches whose faces cross after a displacement but not before, or come closer than ``gap``.

        Sorted by the number of pairs of faces, most first. Walls that have passed each other completely are not found
        here but by :meth:`contact`.
        """
        change = np.tile(displacement.take(self.nodes, axis=0), (len(self.points) // len(self.nodes), 1))
        moved: BoolArray = np.logical_or.reduce([along != 0.0 for along in change.T])
        asked = moved.take(self.faces.T).any(axis=0) & (self.role != SLIDING)
        if not asked.any():
            return ()
        # Of a grid in parts, every rank tests an equal share of the faces.
        ranks, own = self._grid.nodes.ranks, np.zeros_like(asked)
        own[np.array_split(np.flatnonzero(asked), ranks.count)[ranks.number]] = True
        change += self.points
        change += self._shift(gap)
        found = ranks.gather([crossing_faces(change, self.faces, self.role, own)])
        # Two ranks find a pair whose faces belong to different shares.
        pairs, once = np.unique(np.concatenate([pairs for pairs, _ in found]), axis=0, return_index=True)
        places = np.concatenate([places for _, places in found])[once]
        # The position of the faces of a slip plane that nodes leave is unknown.
        if self._boundary.slip.departure(displacement) > 1e-9 * self._size:
            sure = (self.role[pairs] != SLIDING).all(axis=1)
            pairs, places = pairs[sure], places[sure]
        if not len(pairs):
            return ()
        new = self._were_apart(pairs, gap)
        pairs, places = pairs[new], places[new]
        if self._normal is not None:
            # The boundary of a plane grid is tested as a strip beside its plane.
            places = places - ((places - self.points[0]) @ self._normal)[:, None] * self._normal
        # One crossing per pair of patches, at the place closest to the mean of all.
        groups: dict[tuple[str, str], list[int]] = {}
        for index, pair in enumerate(self._names(moved)[pairs].tolist()):
            one, two = sorted(pair)
            groups.setdefault((one, two), []).append(index)
        crossings = []
        for patches, members in groups.items():
            here = places[members]
            x, y, z = here[np.argmin(np.linalg.norm(here - here.mean(axis=0), axis=1))]
            crossings.append(Crossing(patches, (float(x), float(y), float(z)), len(members)))
        return tuple(sorted(crossings, key=lambda crossing: -crossing.count))

    def contact(self, path: Callable[[float], FloatArray]) -> Contact | None:
        """First contact of the boundary with itself on a ``path`` that gives the displacement at a fraction of the
        motion; ``None`` if there is no crossing at the end."""
        last = path(1.0)
        found = self.crossings(last)
        if not found and not self._outside(last):
            return None
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            crossings = self.crossings(path(middle))
            if crossings or self._outside(path(middle)):
                high, found = middle, crossings or found
            else:
                low = middle
        # Faces that meet between the two fractions are at most that far apart; this also finds parallel walls.
        at = path(high)
        gap = 2.0 * float(np.abs(at - path(low)).max())
        return Contact(low, self.crossings(at, gap) or found)

    def _names(self, moved: BoolArray) -> np.ndarray:
        """Name of the patch (m,) of every face; fixed faces that moving patches drag along belong to these."""
        topology, boundary = self._topology, self._boundary
        owner = np.zeros(len(topology.partner), dtype=np.int64)
        carrier = np.full(topology.n_unique, -1)
        patches = boundary.patches
        # Ascending strength: a face on several patches is named after the strongest.
        for index in sorted(range(len(patches)), key=lambda n: patches[n].kind):
            owner[patches[index].quads] = index
            if patches[index].kind is Kind.MOVING:
                carrier[patches[index].nodes] = index
        corners = self.faces % len(self.nodes)
        carried = np.where(moved[corners], carrier[self.nodes[corners]], -1).max(axis=1)
        fixed = boundary.quad_kind[self.quads] == Kind.FIXED
        name = np.where(fixed & (carried >= 0), carried, owner[self.quads])
        return np.array([patch.name for patch in patches])[name]

    @cached_property
    def _outside_faces(self) -> IntArray:
        return self._topology.quads.corners[self._topology.external]

    def _outside(self, displacement: FloatArray) -> bool:
        """Whether a moving part of the boundary has come to lie outside the rest (or inside out)."""
        faces = self._outside_faces[(displacement[self._outside_faces] != 0.0).any(axis=2).all(axis=1)]
        if not len(faces):
            return False
        # Some faces of each of the largest connected parts.
        part, chosen = connected_rows(faces, self._topology.n_unique), []
        for largest in np.argsort(-np.bincount(part))[:_PARTS]:
            members = np.flatnonzero(part == largest)
            places = np.linspace(0, len(members) - 1, min(_PLACES + 2, len(members))).astype(np.int64)
            chosen.append(members[places][1:-1])
        samples = faces[np.concatenate(chosen)]
        before = self._grid.nodes.at(self._topology.first)
        inside = [self._winding(x, samples) for x in (before, before + displacement)]
        # The winding number is meaningful only where the boundary is closed before and after.
        sure = (np.abs(inside[0] - 1.0) < 0.02) & (np.abs(inside[1] - np.round(inside[1])) < 0.02)
        return bool((sure & (np.round(inside[1]) != 1.0)).any())

    def _winding(self, points: FloatArray, samples: IntArray) -> FloatArray:
        """Winding number (k,) of the boundary about points just inside the faces ``samples`` (k, 2 or 4)."""
        if self._normal is not None:
            # The outside lies to the right of an edge.
            a, b = points[samples[:, 0]], points[samples[:, 1]]
            one, two = (points[self._outside_faces[:, k]] for k in (0, 1))
            return plane_winding(one, two, self._normal, 0.5 * (a + b) + _INSIDE * np.cross(self._normal, b - a))
        triangles = np.concatenate([self._outside_faces[:, [0, 1, 2]], self._outside_faces[:, [2, 3, 0]]])
        a, b, c = (points[samples[:, k]] for k in range(3))
        area = np.cross(b - a, c - a)
        size = np.linalg.norm(area, axis=1, keepdims=True)
        return winding(points, triangles, (a + b + c) / 3.0 - _INSIDE * area / np.sqrt(np.maximum(size, 1e-300)))

    def _shift(self, gap: float) -> FloatArray:
        """Pseudo-random shift (n, 3) of the points, by which faces that come closer than ``gap`` cross somewhere."""
        return self._directions * np.where(np.isfinite(self.edge), self._amplitude(gap), 0.0)[:, None]

    def _amplitude(self, gap: float) -> FloatArray:
        # The test for lying outside uses points at a small distance from the faces, which is allowed for here.
        reach = gap + 4.0 * _INSIDE * self.edge if gap else 0.0
        return np.clip(reach, TOUCH * self.edge, 0.05 * self.edge)

    def _were_apart(self, pairs: IntArray, gap: float) -> BoolArray:
        """Which pairs (c, 2) contain a face that touched no other one before it moved."""
        crossing = np.zeros(len(self.faces), dtype=bool)
        crossing[pairs] = True
        close = np.maximum(_ABUTTING * self.edge, 4.0 * self._amplitude(gap))[self.faces].min(axis=1)
        return np.asarray(~near_faces(self.points, self.faces, crossing, close)[pairs].all(axis=1))


def torn_faces(grid: Grid, topology: Topology, boundary: Boundary, displacement: FloatArray) -> list[Notice]:
    """Warnings about fixed patches whose faces a displacement (n_unique, 3) tears at the edges of moving ones."""
    notices = []
    for patch in boundary.patches:
        if patch.kind is not Kind.FIXED or patch.name == UNSELECTED:
            continue
        corners = topology.quads.corners[patch.quads]
        number = (boundary.kind == Kind.MOVING).take(corners).sum(axis=1)
        corners = corners[(number > 0) & (number < corners.shape[1])]
        if not corners.size:
            continue
        x, moved = grid.nodes.at(topology.first[corners]), displacement[corners]
        edge, apart = (np.linalg.norm(each - np.roll(each, 1, axis=1), axis=-1) for each in (x, moved))
        torn = apart > _TORN * edge
        if torn.any():
            worst = np.unravel_index(np.argmax(np.where(torn, apart, 0.0)), torn.shape)
            text = (
                f"the fixed boundary {patch.name!r} is torn where it touches moving nodes: they leave their neighbours "
                f"by up to {apart[worst]:.3g} where its faces are {edge[worst]:.3g} long, near {vector(x[worst])}; let "
                f'the motion vanish there (`meshdeform init` proposes one that does), or give it kind = "slip"'
            )
            notices.append(Notice(text, f"fixed boundary {patch.name} torn"))
    return notices
