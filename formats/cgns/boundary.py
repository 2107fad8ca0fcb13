"""Boundary conditions (BC_t) of structured zones as patches."""

from __future__ import annotations

from collections.abc import Mapping

from meshdeform_core.grid import Patch

from .notes import Notes
from .points import condition_windows
from .tree import Node
from .zone import Base, Zone


def family_conditions(base: Base) -> dict[str, str]:
    """The boundary condition that each Family_t prescribes, by family name."""
    families = base.node.labelled("Family_t")
    return {node.name: condition.text() for node in families for condition in node.labelled("FamilyBC_t")[:1]}


def zone_patches(zone: Zone, block: int, families: Mapping[str, str], notes: Notes) -> list[Patch]:
    """One patch per BC_t of the zone, in file order, with its name; names are unique only within a zone."""
    patches = []
    for group in zone.node.labelled("ZoneBC_t"):
        for condition in group.labelled("BC_t"):
            windows = condition_windows(condition, zone, block, notes)
            if windows:
                family = _family(condition)
                bc_type = _bc_type(condition, family, families)
                patches.append(Patch(condition.name, tuple(windows), family, bc_type))
    return patches


def _family(condition: Node) -> str:
    """FamilyName, else the first AdditionalFamilyName, else nothing."""
    names = condition.labelled("FamilyName_t") + condition.labelled("AdditionalFamilyName_t")
    return names[0].text() if names else ""


def _bc_type(condition: Node, family: str, families: Mapping[str, str]) -> str:
    own = condition.text()
    return families.get(family.rsplit("/", 1)[-1], own) if own == "FamilySpecified" else own
