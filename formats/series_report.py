"""Report of a series: what all levels share, one record per level, and the verdict over all of them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence

from meshdeform_core.series import Level, Schedule

from .report import Report, boundary_part, cell_part, head_part, method_part

_LISTED = 20


def series_head(level: Level) -> Report:
    """What all levels share: grid, method, boundary, quality of the undeformed grid, warnings of the set-up."""
    result = level.result
    return {
        **head_part(result.setup.grid),
        "method": method_part(result.setup.case.method.name, result.account),
        "boundary": boundary_part(result.setup),
        "quality": {"before": dataclasses.asdict(result.assessment.before)},
        "warnings": list(result.setup.warnings),
    }


def level_record(level: Level, file: str, write_seconds: float, head: Report, warned: Sequence[str]) -> Report:
    """One level of the report.

    ``method`` has the parameters that differ from those in ``head``; ``warnings`` those that no earlier level gave
    (``warned``), whatever numbers are in them; at most 20 invalid cells are listed.
    """
    result = level.result
    known = {_without_numbers(text) for text in warned}
    warnings = {_without_numbers(text): text for text in reversed(result.warnings)}
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
        "drift": dataclasses.asdict(level.drift) if level.drift else None,
        "quality": dataclasses.asdict(result.assessment.after),
        "invalid_cells": [cell_part(cell) for cell in result.assessment.invalid[:_LISTED]],
        "method": {key: value for key, value in method.items() if head["method"].get(key) != value},
        "timing": {**seconds, "total": sum(seconds.values())},
        "warnings": [text for key, text in warnings.items() if key not in known],
    }


def _without_numbers(text: str) -> str:
    return re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", "#", text)


def series_report(
    head: Report,
    levels: Sequence[Report],
    schedule: Schedule,
    view: str | None,
    timing: Mapping[str, float],
    total: float,
    peak_memory: int,
) -> Report:
    """The report over all levels.

    Parameters
    ----------
    view : the file to open in ParaView
    timing : seconds of this run that belong to no level (reading, topology, putting files together)
    total : seconds of this run
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
            "view": view,
            "drift": levels[-1]["drift"],
        },
        "levels": list(levels),
        "valid": all(level["valid"] for level in levels),
        "timing": {**timing, **spent, "total": total},
        "peak_memory_bytes": peak_memory,
        "warnings": warnings,
    }


def series_lines(report: Report) -> Iterator[str]:
    """The levels as a table for people."""
    series, levels = report["series"], report["levels"]
    before = report["quality"]["before"]["f_skew"]
    yield f"series    {series['levels']} levels, each from the {_ORIGINS[series['origin']]}"
    if series["view"]:
        yield f"          open {series['view']} in ParaView"
    yield f"          f_skew of the undeformed grid: mean {before['harmonic_mean']:.4f}, minimum {before['min']:.4f}"
    yield (
        f"level     {'time':>12s} {'moved':>10s} {'turned':>8s} {'f_skew':>7s} {'min':>7s} {'invalid':>8s}"
        f" {'drift':>9s} {'prepare':>8s} {'apply':>8s} {'total s':>8s}"
    )
    for level in levels:
        skew, drift, timing = level["quality"]["f_skew"], level["drift"], level["timing"]
        shown = f"{drift['max']:9.2e}" if drift else f"{'':9s}"
        yield (
            f"{level['number']:5d}     {level['time']:12.6g} {level['max_displacement']:10.4g} "
            f"{level['max_rotation_deg']:7.2f}° {skew['harmonic_mean']:7.4f} {skew['min']:7.4f} "
            f"{level['quality']['invalid_cells']:8,} {shown} {timing.get('prepare', 0.0):8.2f} "
            f"{timing.get('apply', 0.0):8.2f} {timing['total']:8.2f}"
        )
    yield f"verdict   {'valid' if report['valid'] else 'INVALID'}"
    if series["drift"]:
        yield (
            f"drift     {series['drift']['max']:.3g} at most, {series['drift']['rms']:.3g} rms: distance of the last "
            f"level from the grid made from the undeformed one"
        )


_ORIGINS = {"reference": "undeformed grid", "last": "level before (marching)"}
