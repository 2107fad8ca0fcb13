"""Reports of a deformation or a quality check: one dictionary, written as json, text or html."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Result, Setup
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Account
from meshdeform_core.quality import Assessment, InvalidCell

from .files import replacing

SCHEMA = 1
SUFFIXES = (".json", ".txt", ".html")
Report = dict[str, Any]


def deformation_report(result: Result, timing: Mapping[str, float], peak_memory: int) -> Report:
    """The report of :func:`meshdeform_core.deform.deform` (contract, schema 1).

    Parameters
    ----------
    timing : seconds of reading, writing and in total, which only the caller knows
    peak_memory : largest resident size of the process, bytes
    """
    setup = result.setup
    boundary = boundary_part(setup) | {"max_displacement": result.max_displacement}
    seconds = dict.fromkeys(("read", "topology", "prepare", "apply", "quality", "write", "total"), 0.0)
    return {
        **head_part(setup.grid),
        "method": method_part(setup.case.method.name, result.account),
        "boundary": boundary,
        **_quality_part(result.assessment),
        "valid": result.valid,
        "invalid_cells": [cell_part(cell) for cell in result.assessment.invalid],
        "steps": result.steps,
        "reached": result.reached,
        "timing": seconds | result.timing.seconds | dict(timing),
        "peak_memory_bytes": peak_memory,
        "warnings": list(result.warnings),
    }


def quality_report(grid: Grid, assessment: Assessment, warnings: tuple[str, ...]) -> Report:
    """The report of a grid on its own or against its original."""
    return {
        **head_part(grid),
        **_quality_part(assessment),
        "valid": assessment.valid,
        "invalid_cells": [cell_part(cell) for cell in assessment.invalid],
        "warnings": list(warnings),
    }


def plan_report(setup: Setup, account: Account, extra: Mapping[str, Any]) -> Report:
    """What ``--dry-run`` prints: everything that is decided before anything moves."""
    return {
        **head_part(setup.grid),
        "method": method_part(setup.case.method.name, account),
        "boundary": boundary_part(setup) | dict(extra),
        "warnings": [*setup.warnings, *account.warnings],
    }


def write_report(report: Report, path: Path) -> None:
    """Write a report; the suffix picks json, txt or html.

    Raises
    ------
    FormatError
        For another suffix, or when the file cannot be written.
    """
    check_report_path(path)
    if path.suffix == ".json":
        text = json.dumps(report, indent=2, allow_nan=False) + "\n"
    elif path.suffix == ".txt":
        from .report_text import as_text

        text = as_text(report)
    else:
        from .report_html import as_html

        text = as_html(report)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def check_report_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix not in SUFFIXES:
        raise FormatError(f"report {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")


def head_part(grid: Grid) -> Report:
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
    """Patches, node counts, what tables matched."""
    boundary, topology = setup.boundary, setup.topology
    part: Report = {
        "patches": [{"name": p.name, "kind": p.kind.label, "nodes": len(p.nodes)} for p in boundary.patches],
        "moving_nodes": boundary.count(Kind.MOVING),
        "fixed_nodes": boundary.count(Kind.FIXED),
        "slip_nodes": boundary.count(Kind.SLIP, Kind.SYMMETRY),
        "interface_nodes": boundary.count(*(kind for kind in Kind if kind < Kind.FIXED)),
        "interior_nodes": setup.grid.n_nodes - len(topology.face_nodes),
    }
    matches = [match for _, motion in boundary.movers for match in motion.matches]
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
            }
            for m in matches
        ]
    return part


def _quality_part(assessment: Assessment) -> Report:
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
        "nearest_patch": cell.nearest_patch,
        "center": list(cell.center),
        "step": cell.step,
    }
