"""Contents of reports, dictionaries of JSON types: of a deformation, a series, a quality check, a repair, a dry run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Result, Setup
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Account
from meshdeform_core.methods.limits import PatchMotion
from meshdeform_core.quality import Assessment

from ..grids import Layout

if TYPE_CHECKING:
    from meshdeform_core.mending import Mended
    from meshdeform_core.series import Level, Schedule

SCHEMA = 1
_SMOOTHNESS = ("velocity", "acceleration", "acceleration_in_edges")
_LISTED = 20
"""Invalid cells of a level that its record lists."""
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
    boundary, topology, sliding = setup.boundary, setup.topology, (Kind.SLIP, Kind.SYMMETRY)
    part: Report = {
        "patches": [{"name": p.name, "kind": p.kind.label, "nodes": len(p.nodes)} for p in boundary.patches],
        "moving_nodes": boundary.count(Kind.MOVING),
        "fixed_nodes": boundary.count(Kind.FIXED),
        "slip_nodes": boundary.count(*sliding),
        "interface_nodes": boundary.count(*(kind for kind in Kind if kind < Kind.FIXED and kind not in sliding)),
        "interior_nodes": setup.grid.n_nodes - len(topology.face_nodes),
    }
    for m, motion in ((match, each) for _, each in boundary.movers for match in each.matches):
        # Sizes of the table and of the wall that it moves: their ratio is 1000 when their length units differ.
        both = (m.points, motion.nodes.points[m.matched])
        table, wall = (float(np.linalg.norm(np.ptp(x, axis=0))) if len(x) else None for x in both)
        part.setdefault("matches", []).append(
            {
                "table": m.label,
                "match": m.how,
                "matched_nodes": int(m.matched.sum()),
                "unmatched_nodes": int((~m.matched).sum()),
                "table_points": m.used[1],
                "table_points_used": m.used[0],
                "max_distance": float(m.distance[m.matched].max(initial=0.0)),
                "max_extrapolation": float(m.beyond[m.matched].max(initial=0.0)),
                "walls": list(m.matching.walls),
                "size_ratio": table / wall if table is not None and wall else None,
            }
        )
    return part


def quality_part(assessment: Assessment) -> Report:
    """Quality before and after, and the change."""
    return {
        "quality": {
            "before": dataclasses.asdict(assessment.before),
            "after": dataclasses.asdict(assessment.after),
            "change": assessment.change,
        }
    }


def _invalid_part(assessment: Assessment, most: int | None = None) -> Report:
    """Invalid cells, at most ``most`` of them."""
    cells = [dataclasses.asdict(cell) for cell in assessment.invalid[:most]]
    return {"invalid_cells": [cell | {"ijk": list(cell["ijk"]), "center": list(cell["center"])} for cell in cells]}


def with_other(timing: Mapping[str, float], total: float) -> Report:
    """Seconds by stage, with the remainder to ``total`` as ``other``, so that they add up."""
    stages = {name: seconds for name, seconds in timing.items() if name not in ("other", "total")}
    spent = sum(stages.values())
    return {**stages, "other": max(0.0, total - spent), "total": max(total, spent)}


def deformation_report(result: Result, timing: Mapping[str, float], peak_memory: int) -> Report:
    """The report of :func:`meshdeform_core.deform.deform` (schema 1).

    Parameters
    ----------
    timing : seconds of reading and writing, which only the caller knows; ``with_other`` completes them
    peak_memory : largest resident size of the process, bytes
    """
    setup = result.setup
    components = [component_part(name, own) for name, own in result.components]
    seconds = dict.fromkeys(("read", "topology", "prepare", "apply", "quality", "write"), 0.0)
    return {
        **plan_report(setup, result.account, result.max_displacement, result.motion),
        **quality_part(result.assessment),
        **_outcome_part(result),
        **_invalid_part(result.assessment),
        **({"components": components} if components else {}),
        "timing": seconds | result.timing.seconds | dict(timing),
        "peak_memory_bytes": peak_memory,
        "warnings": list(result.warnings),
    }


def quality_report(
    grid: Grid,
    assessment: Assessment,
    warnings: tuple[str, ...],
    reference: str | None = None,
    original: Grid | None = None,
) -> Report:
    """The report of a grid by itself or against its ``original``, the file ``reference``."""
    return {
        **head_part(grid),
        "reference": reference,
        **quality_part(assessment),
        "shape": {"before": None if original is None else _shape_part(original), "after": _shape_part(grid)},
        "valid": assessment.valid,
        **_invalid_part(assessment),
        "warnings": list(warnings),
    }


def mended_report(mended: Mended, reference: str, seconds: Mapping[str, float], peak_memory: int) -> Report:
    """The report of a repair of a grid against the file ``reference``; ``seconds`` by stage, peak memory in bytes."""
    found = mended.repair
    return {
        **quality_report(mended.grid, mended.assessment, mended.warnings, reference, mended.original),
        "repair": None if found is None else dataclasses.asdict(found),
        "new_interior": None if mended.renewal is None else dataclasses.asdict(mended.renewal),
        "timing": dict(seconds),
        "peak_memory_bytes": peak_memory,
    }


def _shape_part(grid: Grid) -> Report:
    """Measures that matter to flow solvers, with the worst cell of each."""
    from meshdeform_core.quality.shape import shape_measures

    return {name: dataclasses.asdict(measure) for name, measure in shape_measures(grid).items()}


def plan_report(setup: Setup, account: Account, largest: float, motion: Sequence[PatchMotion] = ()) -> Report:
    """The report of ``--dry-run``: everything that is determined before the boundary moves.

    ``largest`` is the largest displacement, ``motion`` that of every moving boundary entry.
    """
    return {
        **head_part(setup.grid),
        "method": method_part(setup.case.method.name, account),
        "boundary": boundary_part(setup) | {"max_displacement": largest},
        "motion": [dataclasses.asdict(patch) for patch in motion],
        "warnings": [*setup.warnings, *account.warnings],
    }


def _outcome_part(result: Result) -> Report:
    """How a deformation ended."""
    return {
        "valid": result.valid,
        "steps": result.steps,
        "reached": result.reached,
        "attempts": [dataclasses.asdict(attempt) for attempt in result.attempts],
        "repair": None if result.repair is None else dataclasses.asdict(result.repair),
    }


def _component_outcome(name: str, result: Result) -> Report:
    """The outcome of the deformation of one component."""
    return {"name": name, **_outcome_part(result), "invalid_cells": result.assessment.after.invalid_cells}


def component_part(name: str, result: Result) -> Report:
    """The outcome for one component, with its size, motion and quality."""
    grid = result.setup.grid
    return {
        **_component_outcome(name, result),
        "blocks": list(grid.names),
        "nodes": grid.n_nodes,
        "cells": grid.n_cells,
        "moving_nodes": result.setup.boundary.count(Kind.MOVING),
        "max_displacement": result.max_displacement,
        **quality_part(result.assessment),
    }


def series_head(level: Level) -> Report:
    """Data common to all levels: grid, method, boundary, quality of the undeformed grid, warnings of the set-up."""
    result = level.result
    return {
        **head_part(result.setup.grid),
        "method": method_part(result.setup.case.method.name, result.account),
        "boundary": boundary_part(result.setup),
        "quality": {"before": dataclasses.asdict(result.assessment.before)},
        "warnings": list(result.setup.warnings),
    }


def level_record(level: Level, file: str, write_seconds: float, head: Report, warnings: Sequence[str]) -> Report:
    """One level of the report.

    ``method`` has the parameters that differ from those in ``head``; ``warnings`` are the level's new ones; at most 20
    invalid cells are listed.
    """
    result = level.result
    method = method_part(result.setup.case.method.name, result.account)
    seconds = {**result.timing.seconds, "write": write_seconds}
    return {
        "number": level.number,
        "time": level.time,
        "file": file,
        **_outcome_part(result),
        "max_displacement": result.max_displacement,
        "max_rotation_deg": max(each.max_rotation_deg for each in result.motion),
        "motion": [dataclasses.asdict(patch) for patch in result.motion],
        "smoothness": {name: getattr(level.smoothness, name) for name in _SMOOTHNESS},
        **({"components": [_component_outcome(*each) for each in result.components]} if result.components else {}),
        "quality": dataclasses.asdict(result.assessment.after),
        **_invalid_part(result.assessment, _LISTED),
        "method": {key: value for key, value in method.items() if head["method"].get(key) != value},
        "timing": {**seconds, "total": sum(seconds.values())},
        "warnings": list(warnings),
    }


def series_report(
    head: Report,
    levels: Sequence[Report],
    schedule: Schedule,
    places: Mapping[str, str | None],
    timing: Mapping[str, float],
    peak_memory: int,
) -> Report:
    """The report over all levels.

    Parameters
    ----------
    places : ``folder`` of the levels, and ``view``, the file to open in ParaView
    timing : seconds of this run that do not belong to a level (reading, topology, assembling files)
    """
    stages = dict.fromkeys(key for level in levels for key in level["timing"] if key != "total")
    spent = {key: sum(level["timing"].get(key, 0.0) for level in levels) for key in stages}
    warnings = list(head["warnings"])
    warnings += [f"level {level['number']}: {text}" for level in levels for text in level["warnings"]]
    moved = max(level["max_displacement"] for level in levels)
    if moved == 0.0:
        warnings.append("nothing moves: the displacement is zero at all levels")
    return {
        **head,
        "boundary": {**head["boundary"], "max_displacement": moved},
        "series": {"levels": len(levels), "velocity": schedule.velocity, **places},
        "levels": list(levels),
        "valid": all(level["valid"] for level in levels),
        "timing": {**timing, **spent},
        "peak_memory_bytes": peak_memory,
        "warnings": warnings,
    }
