"""Connectivity of structured zones: one-to-one connections, including periodic ones; other types are only noted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, Shape

from .notes import Notes
from .periodic import periodicity
from .tree import Node
from .zone import Base, Zone


def overset_only(zones: Sequence[Zone]) -> bool:
    """Whether several zones are connected only by overset (Chimera) interpolation: they overlap and share no nodes."""
    kinds = [_kind(node) for zone in zones for group in _groups(zone) for node in _members(group)]
    return len(zones) > 1 and "Overset" in kinds and not {"1to1", "Abutting1to1", "Abutting"} & set(kinds)


def zone_connections(base: Base, zones: Sequence[Zone], grid: Grid, notes: Notes) -> list[Connection]:
    """The GridConnectivity1to1_t of all zones in file order.

    Interfaces are found from the coordinates, so that a connection which does not match its zones is noted and
    ignored. ``grid`` has the coordinates, which resolve angles without a unit.
    """
    blocks = {zone.name: block for block, zone in enumerate(zones)}
    connections = []
    for block, zone in enumerate(zones):
        for group in _groups(zone):
            for node in _members(group):
                kind, place = _kind(node), f"{zone.name}/{node.name}"
                if kind == "1to1":
                    donor = blocks.get(_donor_name(node, base))
                    connection = None if donor is None else _connection(node, block, donor, zones)
                    if connection is None:
                        notes.add("connections that do not match their zones are not used", place)
                        continue
                    periodic = periodicity(node, connection, (zone.node, base.node), grid, notes)
                    connections.append(replace(connection, periodic=periodic))
                elif kind:
                    notes.add(
                        f"{kind} connectivity is kept in the file but not used; coincident nodes stay joined", place
                    )
    return connections


def _groups(zone: Zone) -> list[Node]:
    return zone.node.labelled("ZoneGridConnectivity_t")


def _members(group: Node) -> Sequence[Node]:
    """The members of a ZoneGridConnectivity_t; broken links are refused, as they may be connections."""
    group.labelled("GridConnectivity1to1_t")
    return group.target.children


def _kind(node: Node) -> str:
    """``1to1``, or the type of a general connectivity (Overset if it has none, SIDS 8.4), or nothing."""
    label = node.target.label
    if label == "GridConnectivity1to1_t":
        return "1to1"
    if label == "GridConnectivity_t":
        types = node.labelled("GridConnectivityType_t")
        return types[0].text() if types else "Overset"
    return "Overset" if label == "OversetHoles_t" else ""


def _donor_name(node: Node, base: Base) -> str:
    """Name of the donor zone; ``Base/Zone`` is accepted for the same base."""
    return node.text().removeprefix(f"{base.node.name}/")


def _connection(node: Node, block: int, donor: int, zones: Sequence[Zone]) -> Connection | None:
    axes = len(zones[block].core)
    begin, end = _range(node, "PointRange", axes)
    donor_begin, donor_end = _range(node, "PointRangeDonor", axes)
    transform = _transform(node, axes)
    if sorted(abs(axis) for axis in transform) != [1, 2, 3]:
        return None
    reached = list(donor_begin)
    for axis, first, last in zip(transform, begin, end, strict=True):
        reached[abs(axis) - 1] += last - first if axis > 0 else first - last
    shape, donor_shape = zones[block].shape, zones[donor].shape
    corners = (begin, shape), (end, shape), (donor_begin, donor_shape), (donor_end, donor_shape)
    if tuple(reached) != donor_end or not all(
        0 <= p < n for at, size in corners for p, n in zip(at, size, strict=True)
    ):
        return None
    return Connection(node.name, block, begin, end, donor, donor_begin, donor_end, transform)


def _range(node: Node, name: str, axes: int) -> tuple[Shape, Shape]:
    """First and last node, 0-based."""
    child = node.child(name)
    if child is None:
        raise FormatError(f"the connection {node.path} has no {name}; every GridConnectivity1to1_t needs one")
    first, last = child.integers(axes, 2).T.tolist()
    return _three([n - 1 for n in first], 0), _three([n - 1 for n in last], 0)


def _transform(node: Node, axes: int) -> Shape:
    """Signed donor axis of each axis; without one the axes correspond in order (SIDS 8.2)."""
    child = node.child("Transform")
    return _three(child.integers(axes).tolist(), 3) if child else (1, 2, 3)


def _three(numbers: Sequence[int], *others: int) -> Shape:
    """Numbers of two or three axes, those of missing axes from the ``others``."""
    a, b, c = (*numbers, *others)[:3]
    return a, b, c
