"""Classification of the boundary: which nodes move, are fixed, slide, are periodic or free; and the motions of all
moving patches as one displacement, checked for contradictions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CaseError, MotionError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Patch
from ..grid.openings import Opening, describe_openings
from ..grid.planes import Plane, plane_normal, plane_of
from ..grid.selection import quads_of_pattern, select_quads
from ..grid.topology import Topology, quads_of_patches
from ..grid.windows import end_planes, rectangles
from ..numerics.arrays import lengths
from ..numerics.geometry.coincidence import distinct
from ..wording import listed, vector
from .constraints import Pairs, Periodic, Slip, crease_notes, find_periodicity, find_sliding
from .motions.expression import Expression
from .motions.motion import Follow, Motion, PreparedMotion, doubtful_rotations
from .tables import BoundaryNodes, SurfaceData, by_place

if TYPE_CHECKING:
    from .fitting import Tables

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
    """One ``[[boundary]]`` entry of a case, with the ``name`` that reports and messages use.

    ``select`` are patterns, see :func:`meshdeform_core.grid.selection.select_quads`; ``where`` is a filter on the
    undeformed coordinates of the selected faces' corner nodes; a ``motion`` belongs to moving ones, and only to these.
    """

    name: str
    select: tuple[str, ...]
    kind: Kind
    where: Expression | None = None
    motion: Motion | None = None

    def __post_init__(self) -> None:
        if (self.kind is Kind.MOVING) != (self.motion is not None):
            found = "has no motion" if self.motion is None else f"is {self.kind.label} but has a motion"
            raise CaseError(f"boundary {self.name!r} {found}; expected a motion for moving ones, and only for these")


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
    tables : displacement tables, checked again whenever they change; ``None`` without any
    """

    kind: np.ndarray
    quad_kind: np.ndarray
    patches: tuple[ClassifiedPatch, ...]
    movers: tuple[tuple[IntArray, PreparedMotion], ...]
    slip: Slip
    periodic: Periodic
    mirrors: tuple[Plane, ...]
    notes: tuple[str, ...]
    tables: Tables | None = None

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
    otherwise nothing could move. Raises CaseError or MotionError when a selection matches nothing or a table matches no
    node.
    """
    corners, n = topology.quads.corners, topology.n_unique
    quad_kind, node_kind = np.zeros(len(corners), dtype=np.int8), np.zeros(n, dtype=np.int8)
    patches, movers, notes = list[ClassifiedPatch](), list[tuple[IntArray, PreparedMotion]](), list[str]()
    pairs = list[Pairs]()
    for spec in specs:
        quads, motion = _selected(grid, topology, spec, constants)
        nodes = reached = distinct(corners[quads], n)
        if motion is not None:
            prepared = motion.prepare(BoundaryNodes.of_quads(grid, topology, quads))
            # Faces that a table does not match are not the entry's, single nodes are.
            reached = prepared.nodes.numbers[prepared.moved]
            movers.append((reached, prepared))
            notes += doubtful_rotations(spec.name, motion)
            quads = quads[np.isin(corners[quads], reached).all(axis=1)]
            nodes = distinct(corners[quads], n)
        if spec.kind is Kind.PERIODIC:
            sides = [select_quads(grid, topology, [pattern], spec.name) for pattern in spec.select]
            pairs += find_periodicity(grid, topology, spec.name, quads, sides)
        patches.append(ClassifiedPatch(spec.name, spec.kind, nodes, quads))
        quad_kind[quads] = np.maximum(quad_kind[quads], spec.kind)
        node_kind[reached] = np.maximum(node_kind[reached], spec.kind)
    tables = None
    if any(motion.matches for _, motion in movers):
        from .fitting import Tables

        tables = Tables([motion for _, motion in movers])
        notes += tables.warnings()
    notes += (note for _, motion in movers for note in motion.notes)
    # Faces that no entry selects.
    rest = np.flatnonzero(topology.external & (quad_kind == 0))
    on_ends = np.isin(topology.quads.block_side[rest], end_planes(grid, topology))
    for name, kind, quads in ("(end planes)", Kind.SLIP, rest[on_ends]), (UNSELECTED, Kind.FIXED, rest[~on_ends]):
        if quads.size:
            patches.append(ClassifiedPatch(name, kind, distinct(corners[quads], n), quads))
            quad_kind[quads] = kind
            node_kind[patches[-1].nodes] = np.maximum(node_kind[patches[-1].nodes], kind)
    if on_ends.any():
        notes.append("the grid is one cell thick: its two end planes, which no boundary entry selects, are slip planes")
    # Where the case is only a table, the other faces are meant to be fixed.
    alone = all(spec.motion and spec.motion.partial for spec in specs)
    notes += _unselected_notes(grid, topology, rest[~on_ends], node_kind == Kind.MOVING, alone) if specs else []
    # Periodic images of a moving or fixed node have its kind, as they move alike.
    periodic, strongest = Periodic.of(pairs, n), np.zeros_like(node_kind)
    np.maximum.at(strongest, periodic.root, node_kind[periodic.nodes])
    known = strongest[periodic.root] >= Kind.FIXED
    node_kind[periodic.nodes[known]] = strongest[periodic.root[known]]
    slipping = [(p.name, p.quads, p.kind is Kind.SYMMETRY) for p in patches if p.kind in (Kind.SLIP, Kind.SYMMETRY)]
    slip, mirrors = find_sliding(grid, topology, slipping, node_kind < Kind.FIXED, node_kind == Kind.MOVING)
    notes += crease_notes(grid, topology, slip)
    return Boundary(node_kind, quad_kind, tuple(patches), tuple(movers), slip, periodic, mirrors, tuple(notes), tables)


def _selected(
    grid: Grid, topology: Topology, spec: BoundarySpec, constants: Mapping[str, float]
) -> tuple[IntArray, Motion | None]:
    """Face quads that an entry selects, and its motion; a table that moves only what it matches selects its wall."""
    motion = spec.motion
    if motion is not None and motion.partial:
        table = next(step for step in motion.steps if isinstance(step, Follow))
        if isinstance(data := table.table(), SurfaceData):
            from .fitting import fit_table

            fit = fit_table(grid, topology, by_place(data, grid, topology), table.matching)
            motion = motion.matched_by(fit.matching)
            if fit.quads is not None:
                return fit.quads, motion
    quads = select_quads(grid, topology, spec.select, spec.name)
    if spec.where is None:
        return quads, motion
    corners = topology.quads.corners[quads]
    nodes = distinct(corners, topology.n_unique)
    x, y, z = points = grid.nodes.at(topology.first[nodes]).T
    holds = np.broadcast_to(np.asarray(spec.where({**constants, "x": x, "y": y, "z": z})), nodes.shape)
    where = f"boundary {spec.name!r}: where = {spec.where.text!r}"
    if (unclear := np.flatnonzero(np.isnan(holds))).size:
        node = int(topology.first[nodes[unclear[0]]])
        raise CaseError(
            f"{where} is not a number at {len(unclear)} of {len(nodes)} nodes, first at {grid.node_label(node)} = "
            f"{vector(grid.points[node])}; expected a condition, like x > 0.5"
        )
    quads = quads[np.isin(corners, nodes[holds.astype(bool)]).all(axis=1)]
    if quads.size == 0:
        ranges = ", ".join(f"{n} {c.min():.4g} to {c.max():.4g}" for n, c in zip("xyz", points, strict=True))
        raise CaseError(
            f"{where} is not satisfied on any face of the selection ({np.count_nonzero(holds)} of {len(nodes)} nodes "
            f"satisfy it; the selection spans {ranges})"
        )
    return quads, motion


def _unselected_notes(
    grid: Grid, topology: Topology, quads: IntArray, moves: BoolArray, expected: bool
) -> Iterator[str]:
    """Warnings about the external face ``quads`` that no entry selects, which are fixed: that there are any, unless
    this is ``expected``; and which of them touch nodes that move (n_unique,)."""
    label = np.full(len(topology.partner), -1)
    label[quads] = 0
    pieces = rectangles(grid, topology.quads, label)
    places = [(grid.window_label(window), pieces.quads_of(number)) for number, window in enumerate(pieces.windows())]
    places.sort(key=lambda place: -len(place[1]))
    if quads.size and not expected:
        yield (
            f"{quads.size:,} external face quads are not selected by any boundary entry; they are fixed (where nodes "
            f'should slide, select them with kind = "slip" or "symmetry"): '
            f"{listed((f'{name} ({len(some):,})' for name, some in places), noun='ranges')}"
        )
    corners, normal = topology.quads.corners, plane_normal(grid)
    touching = {name: corners[some] for name, some in places if moves[corners[some]].any()}
    if touching:
        points = (grid.nodes.at(topology.first[np.unique(nodes)]) for nodes in touching.values())
        flat = all(plane_of(x, normal) is not None for x in points)
        remedy = (
            'they are flat: symmetry planes and end planes need kind = "symmetry" or "slip"'
            if flat
            else 'give them a kind: "slip" lets their nodes follow, "fixed" confirms that they stay'
        )
        advice = " in a case file; `meshdeform init --table` writes one" if expected else ""
        names = listed(touching)
        yield f"faces that no boundary entry selects touch moving nodes but are fixed: {names}; {remedy}{advice}"


def with_plates(grid: Grid, topology: Topology, patterns: Sequence[str]) -> tuple[Grid, Topology]:
    """The plates that the case names (``grid.plates``) as outside faces: walls on both sides among the grid's patches.

    One of the two sides is enough. Nodes of the two sides remain coincident: a plate has no thickness, and its sides
    cannot separate. Raises CaseError when a pattern matches nothing, or no face that two blocks share.
    """
    patches = list(grid.patches)
    for pattern in patterns:
        quads = quads_of_pattern(grid, topology.quads, pattern, "grid.plates")
        shared = quads[topology.partner[quads] >= 0]
        if shared.size == 0:
            raise CaseError(
                f"grid.plates: {pattern!r} selects no face that is shared by two blocks; "
                f"faces on the outside need no entry (see `meshdeform info`)"
            )
        new = np.full(len(topology.partner), -1)
        new[shared] = new[topology.partner[shared]] = 0
        new[quads_of_patches(topology.quads, grid.patches)[0]] = -1
        names = {patch.name for patch in patches}
        name = next(name for n in range(len(names) + 1) if (name := f"plate{n + 1}") not in names)
        if (new == 0).any():
            patches.append(Patch(name, tuple(rectangles(grid, topology.quads, new).windows()), bc_type="wall"))
        topology = topology.opened(shared)
    return (replace(grid, patches=tuple(patches)) if patterns else grid), topology


def opening_notes(
    grid: Grid,
    topology: Topology,
    openings: Sequence[Opening],
    unselected: IntArray,
    moving: IntArray,
    declared: bool | Sequence[str],
) -> list[str]:
    """Warnings about outside faces that nearly coincide with others, unless ``declared``, the value of ``grid.open``,
    says that these faces, or all (``True``), are open. Raises CaseError when a face is ``unselected``, as the grid
    would tear at this fixed wall; faces of ``moving`` entries may separate."""
    if declared is True or not openings:
        return []
    meant = select_quads(grid, topology, declared, "grid.open") if declared else np.empty(0, dtype=np.int64)
    told = [each for each in openings if not any(np.isin(each.quads, known).all() for known in (meant, moving))]
    for opening in told:
        if np.isin(opening.quads, unselected).any():
            count = f" ({len(openings)} such places, see `meshdeform info`)" if len(openings) > 1 else ""
            close = "Close the gap with that tolerance, or say" if opening.matching else "Say"
            raise CaseError(
                f"{opening.describe(grid)}{count}. Nothing selects them, so they would be fixed walls, at which the "
                f"grid tears. {close} that they are walls: [grid] open = true, or a list of faces; or select them in a "
                f"boundary entry{overlap_advice(grid) if opening.inside else ''}"
            )
    return describe_openings(grid, told, overlap_advice(grid))


def overlap_advice(grid: Grid) -> str:
    """What to do about blocks that overlap; empty if the grid is divided into components."""
    return "" if grid.components else "; blocks that overlap on purpose: name their groups in [grid] components"


def prescribed_displacement(
    grid: Grid, topology: Topology, boundary: Boundary, time: float = 0.0, fraction: float = 1.0
) -> FloatArray:
    """Displacement (n_unique, 3) of all face nodes: the motion at moving nodes, zero elsewhere. Raises MotionError when
    two moving patches disagree at a shared node, or a 2-D grid would leave its plane."""
    displacement = np.zeros((topology.n_unique, 3))
    owner = np.full(topology.n_unique, -1)
    for index, (nodes, motion) in enumerate(boundary.movers):
        new, before = motion.displacement(time, fraction)[motion.moved], owner[nodes]
        both = np.flatnonzero(before >= 0)
        gap = np.linalg.norm(displacement[nodes[both]] - new[both], axis=1)
        ratio = gap / topology.edge[nodes[both]]
        if (ratio > 1e-6).any():
            worst = both[int(np.argmax(ratio))]
            node = nodes[worst]
            # The motions are those of the moving patches, in the same order.
            names = [repr(patch.name) for patch in boundary.patches if patch.kind is Kind.MOVING]
            one = owner[node]
            remedy = "give both patches the same motion there, or select these nodes in one of them only"
            for table, entry in ((one, index), (index, one)):
                if any(match.matching.partial for match in boundary.movers[table][1].matches):
                    remedy = (
                        f"the table {names[table]} moves all boundary nodes that it matches: to move these nodes by "
                        f"the table, remove the motion of {names[entry]}, or their rows from the table to move them "
                        f"by {names[entry]}"
                    )
            raise MotionError(
                f"moving patches {names[one]} and {names[index]} disagree at their shared node "
                f"{grid.node_label(int(topology.first[node]))}: displacements {vector(displacement[node])} and "
                f"{vector(new[worst])}; {remedy}"
            )
        displacement[nodes] = new
        owner[nodes] = index
    return _completed(grid, boundary, displacement, owner >= 0)


def largest_displacement(displacement: FloatArray) -> float:
    """Largest length of the rows of ``displacement`` (n, 3)."""
    return float(lengths(displacement).max())


def given_displacement(
    grid: Grid, topology: Topology, boundary: Boundary, nodes: IntArray, values: FloatArray
) -> FloatArray:
    """Displacement (n_unique, 3) of all face nodes from that of the unique ``nodes`` (n, 3), zero elsewhere. Raises
    MotionError when a 2-D grid would leave its plane."""
    displacement, given = np.zeros((topology.n_unique, 3)), np.zeros(topology.n_unique, dtype=bool)
    displacement[nodes], given[nodes] = values, True
    return _completed(grid, boundary, displacement, given)


def given_gradient(grid: Grid, boundary: Boundary, nodes: IntArray, gradient: FloatArray) -> FloatArray:
    """Transpose of :func:`given_displacement`: gradients (n, 3) of ``nodes`` from those (n_unique, 3) of all face
    nodes.

    If several periodic images of a node are given, they share its gradient, so that a displacement along the gradient
    moves them alike.
    """
    periodic, normal = boundary.periodic, plane_normal(grid)
    total = gradient.copy()
    if periodic.nodes.size:
        moving = np.isin(periodic.nodes, nodes)
        shared = periodic.at_images(periodic.at_roots(total) / periodic.count(len(total), moving))
        total[periodic.nodes[moving]] = shared[moving]
    found = total[nodes]
    return found if normal is None else found - np.outer(found @ normal, normal)


def _completed(grid: Grid, boundary: Boundary, displacement: FloatArray, given: BoolArray) -> FloatArray:
    """The displacement completed at periodic images; in 2-D it must stay in the plane."""
    periodic = boundary.periodic
    if periodic.nodes.size:
        moving = given[periodic.nodes]
        # One of the moving images of a node gives the displacement of the others.
        one = np.zeros(len(displacement), dtype=np.int64)
        one[periodic.root[moving]] = np.flatnonzero(moving)
        told = periodic.at_images(periodic.at_roots(displacement, np.unique(one[periodic.root[moving]])))
        apart = np.linalg.norm(told[moving] - displacement[periodic.nodes[moving]], axis=1)
        if apart.max(initial=0.0) > 1e-6 * np.abs(displacement).max():
            worst = int(np.argmax(apart))
            raise MotionError(
                f"two periodic images of a node move differently: "
                f"{vector(displacement[periodic.nodes[moving]][worst])} where the other would give it "
                f"{vector(told[moving][worst])}; give both the same motion, or move only one of them"
            )
        image = np.isin(periodic.root, periodic.root[moving]) & ~moving
        displacement[periodic.nodes[image]] = told[image]
    normal = plane_normal(grid)
    if normal is not None and np.abs(displacement @ normal).max() > 1e-9 * np.abs(displacement).max():
        raise MotionError(
            f"the motion leaves the plane of the 2-D grid by {np.abs(displacement @ normal).max():.3g}; "
            f"expected displacements normal to {vector(normal)}"
        )
    return displacement
