"""Common parts of all reports; a report is a dictionary of JSON types."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.motion import PreparedMotion
from meshdeform_core.boundary.tables.matching import Transfer
from meshdeform_core.deform import Setup
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Account
from meshdeform_core.quality import Assessment, InvalidCell

from ..layout import Layout

SCHEMA = 1
Report = dict[str, Any]


def head_part(grid: Grid | Layout) -> Report:
    """Versions and the grid."""
    return {
        "schema": SCHEMA,
        "meshdeform": version("meshdeform"),
        "grid": {
            "file": str(grid.path) if grid.path else None,
            "format": grid.format.label if grid.format else None,
            "dimension": grid.dimension,
            "blocks": grid.n_blocks,
            "nodes": grid.n_nodes,
            "cells": grid.n_cells,
        },
    }


def method_part(name: str, account: Account) -> Report:
    """The method with its parameters."""
    part: Report = {"name": name}
    for key, setting in account.settings.items():
        part[key] = {"value": setting.value} | ({"reason": setting.reason} if setting.reason else {})
    return part


def boundary_part(setup: Setup) -> Report:
    """Patches, node counts, matches of tables."""
    boundary, topology = setup.boundary, setup.topology
    part: Report = {
        "patches": [{"name": p.name, "kind": p.kind.label, "nodes": len(p.nodes)} for p in boundary.patches],
        "moving_nodes": boundary.count(Kind.MOVING),
        "fixed_nodes": boundary.count(Kind.FIXED),
        "slip_nodes": boundary.count(Kind.SLIP, Kind.SYMMETRY),
        "interface_nodes": boundary.count(*(kind for kind in Kind if kind < Kind.FIXED)),
        "interior_nodes": setup.grid.n_nodes - len(topology.face_nodes),
    }
    matches = [(match, motion) for _, motion in boundary.movers for match in motion.matches]
    if matches:
        part["matches"] = [
            {
                "table": m.label,
                "match": m.how,
                "matched_nodes": int(m.matched.sum()),
                "unmatched_nodes": int((~m.matched).sum()),
                "table_points": m.used[1],
                "table_points_used": m.used[0],
                "max_distance": float(m.distance[m.matched].max(initial=0.0)),
                "max_extrapolation": float(m.beyond[m.matched].max(initial=0.0)),
                "walls": list(m.walls),
                "size_ratio": _size_ratio(m, motion),
            }
            for m, motion in matches
        ]
    return part


def _size_ratio(match: Transfer, motion: PreparedMotion) -> float | None:
    """Size of a table relative to that of the wall it moves: 1000 when their length units differ."""
    wall = motion.nodes.points[match.matched]
    if not len(match.points) or not len(wall):
        return None
    table, moved = (float(np.linalg.norm(np.ptp(points, axis=0))) for points in (match.points, wall))
    return table / moved if moved > 0 else None


def quality_part(assessment: Assessment) -> Report:
    """Quality before and after, and the change."""
    return {
        "quality": {
            "before": dataclasses.asdict(assessment.before),
            "after": dataclasses.asdict(assessment.after),
            "change": assessment.change,
        }
    }


def cell_part(cell: InvalidCell) -> Report:
    """One invalid cell."""
    return {
        "block": cell.block,
        "ijk": list(cell.ijk),
        "f_skew": cell.f_skew,
        "min_jacobian": cell.min_jacobian,
        "test": cell.test,
        "nearest_patch": cell.nearest_patch,
        "center": list(cell.center),
        "step": cell.step,
    }


def with_other(timing: Mapping[str, float], total: float) -> Report:
    """Seconds by stage, with the remainder to ``total`` as ``other``, so that they add up."""
    stages = {name: seconds for name, seconds in timing.items() if name not in ("other", "total")}
    spent = sum(stages.values())
    return {**stages, "other": max(0.0, total - spent), "total": max(total, spent)}
