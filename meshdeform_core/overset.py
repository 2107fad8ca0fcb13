"""Overset grids: groups of blocks that may overlap each other and have no node in common.

The grid and its case are split into components; each is deformed as if it were alone, and the results are joined. What
lies below this module deforms a grid without knowing whether it is a component of another.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from .boundary import Boundary, Kind
from .boundary.classification import ClassifiedPatch
from .boundary.constraints import Periodic, find_sliding
from .boundary.crossing import Contact, Crossing
from .errors import CaseError
from .grid import FloatArray, Grid, IntArray
from .grid.topology import RELATIVE_TOLERANCE, FaceQuads, Topology, quads_of_patches
from .memory import MemoryLimit
from .methods import Account, Options, PreparedMethod, Progress
from .methods.base import Kinks, Linearised
from .methods.composite import filled
from .methods.limits import patch_motions
from .numerics.arrays import places_among
from .numerics.geometry.coincidence import coincident_copies, distinct, equal_rows
from .parallel import Nodes
from .quality import assess
from .repair.options import Limit
from .repair.outcome import Repair
from .setup import Result, Setup, Undeformed
from .stepping import Course
from .wording import Notice, kind_of


def require_apart(grid: Grid, topology: Topology) -> None:
    """Refuse components that share block faces other than declared patches: a motion would tear the grid there."""
    alone = topology.external.copy()
    alone[quads_of_patches(topology.quads, grid.patches)[0]] = False
    outside = np.flatnonzero(alone)
    nodes = distinct(topology.quads.corners[outside], topology.n_unique)
    label = np.zeros(topology.n_unique, dtype=np.int64)
    points = grid.points[topology.first[nodes]]
    label[nodes] = coincident_copies(points, topology.edge[nodes], RELATIVE_TOLERANCE)[0]
    corners = label[topology.quads.corners[outside]]
    partner, _ = equal_rows(np.sort(corners, axis=1))
    two = np.flatnonzero(partner >= 0)
    block = topology.quads.block_side[outside] // 6
    two = two[grid.component_numbers[block[two]] != grid.component_numbers[block[partner[two]]]]
    # Wound in opposite directions, as the quads of two neighbours are.
    own, other = corners[two], corners[partner[two]]
    start, row = (other == own[:, :1]).argmax(axis=1), np.arange(len(two))
    two = two[other[row, (start - 1) % own.shape[1]] == own[:, 1]]
    if two.size:
        pair = block[two[0]], block[partner[two[0]]]
        names, components = ([of[b] for b in pair] for of in (grid.names, grid.components))
        raise CaseError(
            f"grid.components: blocks {names[0]} of {components[0]!r} and {names[1]} of {components[1]!r} are "
            f"neighbours with common faces ({len(two) // 2} between components in all), at which a motion would tear "
            f"the grid; expected such blocks in one component"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Component:
    """One component as a grid of its own.

    Attributes
    ----------
    name : of the component
    blocks : (n,) its blocks in the whole grid, ascending
    numbers : (n_unique,) its unique nodes in the whole grid, ascending
    undeformed : the component with its boundary
    """

    name: str
    blocks: IntArray
    numbers: IntArray
    undeformed: Undeformed

    def rows(self, whole: Grid, values: FloatArray) -> FloatArray:
        """The component's rows of ``values`` (n_nodes, 3) of the whole grid, in parts if it is."""
        return _copied(self.undeformed.grid, lambda block: whole.in_planes(int(self.blocks[block]), values))

    def motion(self, path: Callable[[float], FloatArray], fraction: float) -> FloatArray:
        """Its rows of the boundary's displacement (n_unique, 3) on a ``path`` of the whole grid."""
        return path(fraction)[self.numbers]


class Overset(Undeformed):
    """An undeformed overset grid: what is asked of it is asked of its components."""

    @cached_property
    def components(self) -> tuple[Component, ...]:
        """The components in the order of their first blocks."""
        low, high = self.grid.nodes.ends
        memory = self.memory.after(24 * (high - low), "components as grids of their own")
        names = dict.fromkeys(self.grid.components)
        return tuple(_component(self, name, number, memory) for number, name in enumerate(names))

    def crossings(self, displacement: FloatArray) -> tuple[Crossing, ...]:
        """Patches of one component whose faces cross; components may pass through each other."""
        found = [each.undeformed.crossings(displacement[each.numbers]) for each in self.components]
        return tuple(sorted(itertools.chain(*found), key=lambda crossing: -crossing.count))

    def contact(self, path: Callable[[float], FloatArray]) -> Contact | None:
        """The first contact of a component with itself."""
        found = [each.undeformed.contact(partial(each.motion, path)) for each in self.components]
        return min((each for each in found if each), key=lambda contact: contact.fraction, default=None)

    def prepare(self, options: Options) -> PreparedMethod:
        """The method prepared on every component that moves."""
        return PreparedComponents(self, options)


def _component(whole: Undeformed, name: str, number: int, memory: MemoryLimit) -> Component:
    """A component, as a grid of its own; motions are evaluated, and tables checked, by the boundary of the whole."""
    grid, topology, faces, boundary = whole.grid, whole.topology, whole.topology.quads, whole.boundary
    blocks = np.flatnonzero(grid.component_numbers == number)
    place = places_among(blocks, grid.n_blocks)
    # Of a grid in parts, every rank holds what it held before.
    shapes, block_names = tuple(grid.shapes[b] for b in blocks), tuple(grid.names[b] for b in blocks)
    bounds = np.clip(grid.nodes.bounds[:, None] - grid.offsets[blocks], 0, np.prod(shapes, axis=1)).sum(axis=1)
    points = Nodes.new(grid.nodes.ranks, bounds, (int(bounds[-1]), 3))
    alone = Grid(points, shapes, block_names, format=grid.format, path=grid.path)
    for n, block in enumerate(blocks.tolist()):
        alone.in_planes(n)[...] = grid.in_planes(block)
    block_of = np.searchsorted(grid.offsets, topology.face_nodes, side="right") - 1
    shift = alone.offsets[place] - grid.offsets[:-1]
    quads, face_nodes = np.flatnonzero(place[faces.block_side // 6] >= 0), np.flatnonzero(place[block_of] >= 0)
    numbers, kind = np.unique(topology.number[face_nodes]), topology.number.dtype
    first = topology.first[numbers]
    node, quad = places_among(numbers, topology.n_unique), places_among(quads, len(boundary.quad_kind))
    sizes, partner = faces.counts[blocks].prod(axis=2), topology.partner[quads]
    own_topology = Topology(
        topology.face_nodes[face_nodes] + shift[block_of[face_nodes]],
        node[topology.number[face_nodes]].astype(kind),
        first + shift[np.searchsorted(grid.offsets, first, side="right") - 1],
        topology.edge[numbers],
        FaceQuads(
            (np.cumsum(sizes) - sizes.ravel()).reshape(sizes.shape),
            faces.counts[blocks],
            node[faces.corners[quads]].astype(kind),
            faces.in_order[blocks],
        ),
        np.where(partner >= 0, quad[partner], partner).astype(partner.dtype),
        topology.handedness[blocks],
        0,
    )
    patches = tuple(
        ClassifiedPatch(patch.name, patch.kind, _within(node, patch.nodes), own)
        for patch in boundary.patches
        if (own := _within(quad, patch.quads)).size
    )
    moving = [patch.name for patch in patches if patch.kind is Kind.MOVING]
    names = [patch.name for patch in boundary.patches if patch.kind is Kind.MOVING]
    movers = zip(names, boundary.movers, strict=True)
    kinds, images = boundary.kind[numbers], boundary.periodic
    sliding = [(p.name, p.quads, p.kind is Kind.SYMMETRY) for p in patches if p.kind in (Kind.SLIP, Kind.SYMMETRY)]
    slip, mirrors = find_sliding(alone, own_topology, sliding, kinds < Kind.FIXED, kinds == Kind.MOVING)
    held = (node[images.nodes] >= 0) & (node[images.root] >= 0)
    own_boundary = Boundary(
        kinds,
        boundary.quad_kind[quads],
        patches,
        tuple((_within(node, moved), motion) for name, (moved, motion) in movers if name in moving),
        slip,
        Periodic(node[images.nodes[held]], node[images.root[held]], images.turn[held]),
        mirrors,
        (),
    )
    return Component(
        name, blocks, numbers, Undeformed(alone, own_topology, own_boundary, memory, min_jacobian=whole.min_jacobian)
    )


def _within(place: IntArray, entries: IntArray) -> IntArray:
    found = place[entries]
    return found[found >= 0]


def _joined(whole: Grid, parts: Sequence[tuple[Component, FloatArray]]) -> FloatArray:
    """Values (n_nodes, 3) of the whole grid from those of all of its components."""
    places = {int(b): (part, n) for part in parts for n, b in enumerate(part[0].blocks)}

    def planes(number: int) -> FloatArray:
        (component, values), place = places[number]
        return component.undeformed.grid.in_planes(place, values)

    return _copied(whole, planes)


def _copied(grid: Grid, planes: Callable[[int], FloatArray]) -> FloatArray:
    """A new array (n_nodes, 3) filled with the values ``planes(b)`` (i, nj, nk, 3) of this rank's planes of every
    block of a grid."""
    found: FloatArray = grid.nodes.like(3)
    for number in range(grid.n_blocks):
        grid.in_planes(number, found)[...] = planes(number)
    return found


Mover = Callable[[FloatArray], FloatArray]
Differentiated = Callable[[Result, PreparedMethod, FloatArray], tuple[Linearised, str]]


class PreparedComponents(PreparedMethod):
    """A method prepared on every component; ``None`` for one without moving boundaries, which remains at rest."""

    def __init__(self, whole: Overset, options: Options):
        self._grid, self._sources = whole.grid, whole.source_numbers
        self.components = whole.components
        alone = [each.undeformed for each in self.components]
        self.methods = [each.prepare(options) if each.boundary.count(Kind.MOVING) else None for each in alone]

    @property
    def account(self) -> Account:
        return _account_of({each.name: method.account for each, method, _ in self._parts() if method})

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return [
            _named(each.name, text)
            for each, method, rows in self._parts()
            if method
            for text in method.warnings_for(motion[rows], step[rows])
        ]

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        applied = [partial(method.apply, progress=progress) if method else None for method in self.methods]
        return self._moved(applied, displacement)

    def _moved(self, movers: Sequence[Mover | None], values: FloatArray) -> FloatArray:
        """What ``movers`` of the components make of their rows of ``values`` of the sources, on all nodes."""
        parts = [
            (each, move(values[rows]) if move else filled(each.undeformed, 0.0))
            for (each, _, rows), move in zip(self._parts(), movers, strict=True)
        ]
        return _joined(self._grid, parts)

    def _parts(self) -> Iterator[tuple[Component, PreparedMethod | None, IntArray]]:
        """Each component with its method, and the rows of its sources among those of the whole grid."""
        for each, method in zip(self.components, self.methods, strict=True):
            yield each, method, np.searchsorted(self._sources, each.numbers[each.undeformed.source_numbers])

    def linearised(self, displacement: FloatArray) -> Linearised:
        found = [method.linearised(displacement[rows]) if method else None for _, method, rows in self._parts()]
        return self._together(found)

    def differentiated(self, result: Result, displacement: FloatArray, one: Differentiated) -> tuple[Linearised, str]:
        """The derivative of a result, and the reason why it does not hold for it, from those of ``one`` component."""
        found, reasons = [], []
        for (_, method, rows), (name, own) in zip(self._parts(), result.components, strict=True):
            derivative, reason = one(own, method, displacement[rows]) if method else (None, "")
            found.append(derivative)
            reasons += [_named(name, reason)] if reason else []
        return self._together(found), "; ".join(reasons)

    def _together(self, found: Sequence[Linearised | None]) -> Linearised:
        """The derivative from those of all components."""

        def pull(gradient: FloatArray) -> FloatArray:
            total = np.zeros((len(self._sources), 3))
            for (each, _, rows), own in zip(self._parts(), found, strict=True):
                if own:
                    total[rows] = own.pull(each.rows(self._grid, gradient))
            return total

        push = partial(self._moved, [own.push if own else None for own in found])
        return Linearised(push, pull, sum((own.kinks for own in found if own), Kinks()))


def impose_on_components(
    whole: Course,
    prepared: PreparedMethod | None,
    one: Callable[[Course, PreparedMethod | None], Result],
) -> Result:
    """The result of a motion from those of ``one`` for the motion of each component, and its method if it is
    ``prepared``."""
    undeformed = whole.setup.undeformed
    assert isinstance(undeformed, Overset)
    known = prepared.methods if isinstance(prepared, PreparedComponents) else [None] * len(undeformed.components)
    found, case = [], whole.setup.case
    for each, method in zip(undeformed.components, known, strict=True):
        own = each.undeformed
        limit, path = Limit.of(own.grid, case.repair.time_limit), partial(each.motion, whole.prescribed)
        course = Course(Setup(own, case, ()), path, whole.precision, whole.timing, whole.progress, limit)
        found.append((each, one(course, method)))
    setup, results = whole.setup, [result for _, result in found]
    points = _joined(setup.grid, [(component, result.grid.points) for component, result in found])
    with whole.timing.stage("quality"):
        assessment = assess(setup.original, points, setup.boundary)
    # As each component lists them, with its own walls and steps, but the worst of all first.
    own_cells = {(cell.block, cell.ijk): cell for result in results for cell in result.assessment.invalid}
    invalid = (own_cells.get((cell.block, cell.ijk), cell) for cell in assessment.invalid)
    warnings = [_named(component.name, text) for component, result in found for text in result.warnings]
    repairs = [result.repair for result in results if result.repair]
    return Result(
        setup=setup,
        grid=setup.grid.moved(points),
        assessment=replace(assessment, invalid=tuple(invalid)),
        account=_account_of({component.name: result.account for component, result in found if result.account.settings}),
        steps=max(result.steps for result in results),
        reached=min(result.reached for result in results),
        displacement=whole.total,
        timing=whole.timing,
        warnings=(*whole.warnings, *warnings),
        motion=patch_motions(setup.problem, whole.total),
        attempts=tuple(attempt for result in results for attempt in result.attempts),
        repair=functools.reduce(Repair.beside, repairs) if repairs else None,
        components=tuple((component.name, result) for component, result in found),
    )


def _account_of(accounts: Mapping[str, Account]) -> Account:
    """The accounts of all components in one; a setting that differs between components is listed by component."""
    merged = Account()
    for key in dict.fromkeys(key for account in accounts.values() for key in account.settings):
        settings = {name: account.settings[key] for name, account in accounts.items() if key in account.settings}
        first = next(iter(settings.values()))
        same = len(settings) == len(accounts) and all(each == first for each in settings.values())
        merged.settings |= {key: first} if same else {f"{key} of {name}": each for name, each in settings.items()}
    for name, account in accounts.items():
        merged.notices |= {f"{name}: {kind}": _named(name, text) for kind, text in account.notices.items()}
    return merged


def _named(component: str, warning: str) -> Notice:
    """A warning with the name of its component."""
    return Notice(f"component {component!r}: {warning}", f"{component}: {kind_of(warning)}")
