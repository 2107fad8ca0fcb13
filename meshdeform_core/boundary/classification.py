"""Classification of the boundary: which nodes move, are fixed, slide, are periodic or free, and the motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from ..errors import CaseError
from ..grid import Grid, IntArray
from ..grid.planes import Plane
from ..grid.selection import select_quads
from ..grid.sides import end_planes
from ..grid.topology import Topology
from ..numerics.geometry.coincidence import distinct
from ..parallel import rows_at
from ..wording import vector
from .coverage import Tables
from .motions.doubts import tiny_rotations
from .motions.expression import Expression
from .motions.motion import Follow, FollowSequence, Motion, PreparedMotion
from .periodic import Periodic, find_periodicity
from .slip import Slip, crease_notes, find_sliding
from .tables.fitting import Fit, fit_table
from .tables.matching import Nodes, SurfaceData
from .unselected import unselected_notes

UNSELECTED = "(not selected)"


class Kind(IntEnum):
    """Kinds of boundary in ascending strength: a node on several patches has the strongest."""

    INTERFACE = 0
    FREE = 1
    PERIODIC = 2
    SLIP = 3
    SYMMETRY = 4
    FIXED = 5
    MOVING = 6

    @property
    def label(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class BoundarySpec:
    """One ``[[boundary]]`` entry of a case.

    Attributes
    ----------
    name : used in reports and messages
    select : patterns, see :func:`meshdeform_core.grid.selection.select_quads`
    kind : kind of its nodes
    where : optional filter on the undeformed coordinates of the selected faces' corner nodes
    motion : required for ``MOVING``, absent otherwise
    """

    name: str
    select: tuple[str, ...]
    kind: Kind
    where: Expression | None = None
    motion: Motion | None = None

    def __post_init__(self) -> None:
        where = f"boundary {self.name!r}"
        if not isinstance(self.kind, Kind):
            known = ", ".join(f"Kind.{kind.name}" for kind in Kind if kind > Kind.INTERFACE)
            raise CaseError(f"{where}: kind = {self.kind!r}; expected one of {known}")
        if isinstance(self.select, str) or not all(isinstance(pattern, str) for pattern in self.select):
            raise CaseError(f"{where}: select = {self.select!r}; expected a sequence of patterns, like ('wing',)")
        if (self.kind is Kind.MOVING) != (self.motion is not None):
            found = "has no motion" if self.motion is None else f"is {self.kind.label} but has a motion"
            raise CaseError(f"{where} {found}; expected a motion for moving boundaries, and only for these")


@dataclass(frozen=True)
class ClassifiedPatch:
    """A classified boundary entry, for reports and for finding the nearest patch.

    ``nodes`` are unique node numbers, ``quads`` face quads; both may also belong to stronger entries.
    """

    name: str
    kind: Kind
    nodes: IntArray
    quads: IntArray


@dataclass(frozen=True, eq=False, repr=False)
class Boundary:
    """The classified boundary of one undeformed grid.

    Attributes
    ----------
    kind : (n_unique,) int8, :class:`Kind` of every unique face node
    quad_kind : (n_quads,) int8, kind of every face quad (``INTERFACE`` for shared ones)
    patches : the entries in the order of the case, then the unselected faces
    slip, periodic : constraints on displacements
    mirrors : symmetry planes
    notes : warnings for the report
    tables : displacement tables, checked again whenever they change
    """

    kind: np.ndarray
    quad_kind: np.ndarray
    patches: tuple[ClassifiedPatch, ...]
    movers: tuple[tuple[IntArray, PreparedMotion], ...]
    slip: Slip
    periodic: Periodic
    mirrors: tuple[Plane, ...]
    notes: tuple[str, ...]
    tables: Tables

    def __repr__(self) -> str:
        return f"Boundary({', '.join(p.name for p in self.patches)})"

    @property
    def known(self) -> np.ndarray:
        """(n_unique,) bool: nodes with prescribed displacement, moving or fixed (the sources)."""
        return self.kind >= Kind.FIXED

    def quads_of(self, chosen: Callable[[ClassifiedPatch], bool]) -> IntArray:
        """Face quads of the chosen patches."""
        found = [patch.quads for patch in self.patches if chosen(patch)]
        return np.concatenate([np.empty(0, dtype=np.int64), *found])

    def count(self, *kinds: Kind) -> int:
        """Unique face nodes of the given kinds."""
        return int(np.isin(self.kind, kinds).sum())


def classify(grid: Grid, topology: Topology, specs: Sequence[BoundarySpec], constants: Mapping[str, float]) -> Boundary:
    """Apply the boundary entries of a case to a grid.

    External faces that no entry selects are fixed, except the end planes of a grid one cell thick, which slide, as
    otherwise nothing could move.

    Raises
    ------
    CaseError, MotionError
        When a selection matches nothing or a table matches no node.
    """
    fits = [_fit(grid, topology, spec) for spec in specs]
    specs = [_following(spec, fit) for spec, fit in zip(specs, fits, strict=True)]
    selected = [
        _select(grid, topology, spec, constants) if fit is None or fit.quads is None else fit.quads
        for spec, fit in zip(specs, fits, strict=True)
    ]
    quad_kind = np.zeros(len(topology.partner), dtype=np.int8)
    movers, tables = _bind_motions(grid, topology, specs, selected)
    doubts = [text for spec in specs if spec.motion for text in tiny_rotations(spec.name, spec.motion)]
    doubts += [*tables.warnings(), *(note for _, motion in movers for note in motion.notes)]
    for spec, quads in zip(specs, selected, strict=True):
        quad_kind[quads] = np.maximum(quad_kind[quads], spec.kind)
    defaults, more = _unselected(grid, topology, quad_kind, specs, movers)
    entries = [*zip([s.name for s in specs], [s.kind for s in specs], selected, strict=True), *defaults]
    for _, kind, quads in defaults:
        quad_kind[quads] = kind
    node_kind = _node_kinds(topology, entries, movers)
    periodic = Periodic.none()
    for spec, quads in zip(specs, selected, strict=True):
        if spec.kind is Kind.PERIODIC:
            sides = [select_quads(grid, topology, [pattern], spec.name) for pattern in spec.select]
            periodic += find_periodicity(grid, topology, spec.name, quads, sides)
    _spread_over_images(node_kind, periodic)
    slipping = [(n, q, k is Kind.SYMMETRY) for n, k, q in entries if k in (Kind.SLIP, Kind.SYMMETRY)]
    slip, mirrors = find_sliding(grid, topology, slipping, node_kind < Kind.FIXED, node_kind == Kind.MOVING)
    patches = tuple(
        ClassifiedPatch(n, k, distinct(topology.quads.corners[q], topology.n_unique), q) for n, k, q in entries
    )
    notes = (*doubts, *more, *crease_notes(grid, topology, slip))
    return Boundary(node_kind, quad_kind, patches, tuple(movers), slip, periodic, mirrors, notes, tables)


def _bind_motions(
    grid: Grid, topology: Topology, specs: Sequence[BoundarySpec], selected: list[IntArray]
) -> tuple[list[tuple[IntArray, PreparedMotion]], Tables]:
    """Unique nodes and motion of every moving entry, and their tables.

    Faces that a table does not match are removed from ``selected``.
    """
    movers: list[tuple[IntArray, PreparedMotion]] = []
    asked: list[tuple[IntArray, PreparedMotion]] = []
    for index, spec in enumerate(specs):
        if spec.motion is None:
            continue
        nodes = Nodes.of_quads(grid, topology, selected[index])
        prepared = spec.motion.prepare(nodes)
        moved = nodes.numbers[prepared.moved]
        movers.append((moved, prepared))
        asked.append((selected[index], prepared))
        if not prepared.moved.all():
            selected[index] = _fully_within(topology, selected[index], moved)
    return movers, Tables(topology, asked)


def _fit(grid: Grid, topology: Topology, spec: BoundarySpec) -> Fit | None:
    """The wall that the table of an entry fits, if the table alone says which nodes move."""
    if spec.motion is None or not spec.motion.partial:
        return None
    tables = [step for step in spec.motion.steps if isinstance(step, Follow | FollowSequence)]
    data = tables[0].first
    return fit_table(grid, topology, data, tables[0].matching) if isinstance(data, SurfaceData) else None


def _following(spec: BoundarySpec, fit: Fit | None) -> BoundarySpec:
    """The entry with the matching of ``fit``, if there is one."""
    if fit is None or spec.motion is None:
        return spec
    return replace(spec, motion=spec.motion.matched_by(fit.matching))


def _select(grid: Grid, topology: Topology, spec: BoundarySpec, constants: Mapping[str, float]) -> IntArray:
    quads = select_quads(grid, topology, spec.select, spec.name)
    if spec.where is None:
        return quads
    corners = topology.quads.corners[quads]
    nodes = distinct(corners, topology.n_unique)
    x, y, z = rows_at(grid.points, topology.first[nodes]).T
    holds = np.broadcast_to(np.asarray(spec.where({**constants, "x": x, "y": y, "z": z})), nodes.shape)
    if np.isnan(holds).any():
        node = int(topology.first[nodes[np.argmax(np.isnan(holds))]])
        raise CaseError(
            f"boundary {spec.name!r}: where = {spec.where.text!r} is not a number at {int(np.isnan(holds).sum())} of "
            f"{len(nodes)} nodes, first at {grid.node_label(node)} = {vector(grid.points[node])}; "
            f"expected a condition, like x > 0.5"
        )
    inside = np.zeros(topology.n_unique, dtype=bool)
    inside[nodes[holds.astype(bool)]] = True
    quads = quads[inside[corners].all(axis=1)]
    if quads.size == 0:
        ranges = ", ".join(f"{n} {c.min():.4g} to {c.max():.4g}" for n, c in zip("xyz", (x, y, z), strict=True))
        raise CaseError(
            f"boundary {spec.name!r}: where = {spec.where.text!r} is not satisfied on any face of the selection "
            f"({np.count_nonzero(holds)} of {len(nodes)} nodes satisfy it; the selection spans {ranges})"
        )
    return quads


def _fully_within(topology: Topology, quads: IntArray, nodes: IntArray) -> IntArray:
    inside = np.zeros(topology.n_unique, dtype=bool)
    inside[nodes] = True
    return quads[inside[topology.quads.corners[quads]].all(axis=1)]


Entry = tuple[str, Kind, IntArray]


def _unselected(
    grid: Grid,
    topology: Topology,
    quad_kind: np.ndarray,
    specs: Sequence[BoundarySpec],
    movers: Sequence[tuple[IntArray, PreparedMotion]],
) -> tuple[list[Entry], list[str]]:
    rest = np.flatnonzero(topology.external & (quad_kind == 0))
    if rest.size == 0:
        return [], []
    entries: list[Entry] = []
    notes = []
    ends = end_planes(grid, topology)
    sliding = rest[np.isin(topology.quads.block_side[rest], ends)]
    fixed = rest[~np.isin(topology.quads.block_side[rest], ends)]
    if sliding.size:
        entries.append(("(end planes)", Kind.SLIP, sliding))
        notes.append("the grid is one cell thick: its two end planes, which no boundary entry selects, are slip planes")
    if fixed.size:
        entries.append((UNSELECTED, Kind.FIXED, fixed))
        if specs:
            moving = np.concatenate([np.empty(0, dtype=np.int64), *(nodes for nodes, _ in movers)])
            table_alone = all(spec.motion and spec.motion.partial for spec in specs)
            notes += unselected_notes(grid, topology, fixed, moving, table_alone)
    return entries, notes


def _node_kinds(topology: Topology, entries: list[Entry], movers: list[tuple[IntArray, PreparedMotion]]) -> np.ndarray:
    kind = np.zeros(topology.n_unique, dtype=np.int8)
    for strength in Kind:
        for _, entry_kind, quads in entries:
            if entry_kind == strength != Kind.MOVING:
                kind[topology.quads.corners[quads]] = strength
    for nodes, _ in movers:
        kind[nodes] = Kind.MOVING
    return kind


def _spread_over_images(kind: np.ndarray, periodic: Periodic) -> None:
    """Give periodic images of a moving or fixed node its kind, as they move alike."""
    if periodic.one.size == 0:
        return
    nodes, root, _ = periodic.frames(len(kind))
    strongest = np.zeros(len(kind), dtype=np.int8)
    np.maximum.at(strongest, root, kind[nodes])
    known = strongest[root] >= Kind.FIXED
    kind[nodes[known]] = strongest[root[known]]
