"""Report of a series: common data, one record per level, and the overall verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from meshdeform_core.series import Level, Schedule
from meshdeform_core.smoothness import Smoothness

from .components import outcome_part
from .parts import Report, boundary_part, cell_part, head_part, method_part

_LISTED = 20


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
    seconds = {**level.timing.seconds, "write": write_seconds}
    return {
        "number": level.number,
        "time": level.time,
        "file": file,
        "valid": result.valid,
        "steps": result.steps,
        "reached": result.reached,
        "max_displacement": result.max_displacement,
        "max_rotation_deg": level.rotation,
        "motion": [dataclasses.asdict(patch) for patch in result.motion],
        "drift": dataclasses.asdict(level.drift) if level.drift else None,
        "smoothness": smoothness_part(level.smoothness),
        "attempts": [dataclasses.asdict(attempt) for attempt in result.attempts],
        "repair": None if result.repair is None else dataclasses.asdict(result.repair),
        **({"components": [outcome_part(*each) for each in result.components]} if result.components else {}),
        "quality": dataclasses.asdict(result.assessment.after),
        "invalid_cells": [cell_part(cell) for cell in result.assessment.invalid[:_LISTED]],
        "invalid_groups": [dataclasses.asdict(group) for group in result.assessment.groups],
        "method": {key: value for key, value in method.items() if head["method"].get(key) != value},
        "timing": {**seconds, "total": sum(seconds.values())},
        "warnings": list(warnings),
    }


def smoothness_part(found: Smoothness) -> Report:
    """Velocity and acceleration of a level's nodes."""
    names = ("velocity", "acceleration", "acceleration_in_edges")
    return {name: getattr(found, name) for name in names}


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
        "series": {
            "levels": len(levels),
            "origin": schedule.origin,
            "velocity": schedule.velocity,
            **places,
            "drift": levels[-1]["drift"],
        },
        "levels": list(levels),
        "valid": all(level["valid"] for level in levels),
        "timing": {**timing, **spent},
        "peak_memory_bytes": peak_memory,
        "warnings": warnings,
    }
