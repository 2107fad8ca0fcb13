"""The boundary of one component of an overset grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from ..grid import FloatArray, IntArray
from ..grid.connectivity.components import Component
from ..numerics.arrays import places_among
from .classification import Boundary, ClassifiedPatch, Kind
from .coverage import Tables
from .crossing import Contact, Crossing, CrossingTest
from .periodic import Periodic
from .slip import find_sliding


def boundary_of(component: Component, boundary: Boundary) -> Boundary:
    """The part of a boundary that belongs to a component.

    Motions are evaluated, and tables checked, by the boundary of the whole grid only.
    """
    nodes = places_among(component.numbers, len(boundary.kind))
    quads = places_among(component.quads, len(boundary.quad_kind))
    patches = tuple(
        ClassifiedPatch(patch.name, patch.kind, _within(nodes, patch.nodes), own)
        for patch in boundary.patches
        if (own := _within(quads, patch.quads)).size
    )
    moving = [patch.name for patch in patches if patch.kind is Kind.MOVING]
    names = [patch.name for patch in boundary.patches if patch.kind is Kind.MOVING]
    movers = tuple(
        (_within(nodes, moved), motion)
        for name, (moved, motion) in zip(names, boundary.movers, strict=True)
        if name in moving
    )
    kind = boundary.kind[component.numbers]
    sliding = [(p.name, p.quads, p.kind is Kind.SYMMETRY) for p in patches if p.kind in (Kind.SLIP, Kind.SYMMETRY)]
    slip, mirrors = find_sliding(component.grid, component.topology, sliding, kind < Kind.FIXED)
    return Boundary(
        kind,
        boundary.quad_kind[component.quads],
        patches,
        movers,
        slip,
        _periodic(nodes, boundary.periodic),
        mirrors,
        (),
        Tables(component.topology, ()),
    )


class ComponentCrossings:
    """Tests whether the boundary of any component crosses itself; components may pass through each other."""

    def __init__(self, tests: Sequence[tuple[Component, CrossingTest | ComponentCrossings]]):
        self._tests = tests

    def crossings(self, displacement: FloatArray, gap: float = 0.0) -> tuple[Crossing, ...]:
        """Patches of one component whose faces cross, see :meth:`CrossingTest.crossings`."""
        found = [each for own, test in self._tests for each in test.crossings(displacement[own.numbers], gap)]
        return tuple(sorted(found, key=lambda crossing: -crossing.count))

    def contact(self, path: Callable[[float], FloatArray]) -> Contact | None:
        """The first contact of a component with itself, see :meth:`CrossingTest.contact`."""
        found = [test.contact(partial(_of, own, path)) for own, test in self._tests]
        return min((each for each in found if each), key=lambda contact: contact.fraction, default=None)


def _of(component: Component, path: Callable[[float], FloatArray], fraction: float) -> FloatArray:
    return path(fraction)[component.numbers]


def _within(place: IntArray, entries: IntArray) -> IntArray:
    found = place[entries]
    return found[found >= 0]


def _periodic(place: IntArray, periodic: Periodic) -> Periodic:
    own = (place[periodic.one] >= 0) & (place[periodic.two] >= 0)
    return Periodic(place[periodic.one[own]], place[periodic.two[own]], periodic.rotation[own])
