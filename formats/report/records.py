"""Reports of a deformation, of a quality check, and of a dry run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from meshdeform_core.deform import Result, Setup
from meshdeform_core.grid import Grid
from meshdeform_core.mending import Mended
from meshdeform_core.methods import Account
from meshdeform_core.methods.limits import PatchMotion
from meshdeform_core.quality import Assessment
from meshdeform_core.quality.per_block import BlockQuality
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.quality.walls import layer_changes

from .components import component_part
from .parts import Report, boundary_part, cell_part, head_part, method_part, quality_part


def deformation_report(result: Result, timing: Mapping[str, float], peak_memory: int) -> Report:
    """The report of :func:`meshdeform_core.deform.deform` (schema 1).

    Parameters
    ----------
    timing : seconds of reading and writing, which only the caller knows; ``with_other`` completes them
    peak_memory : largest resident size of the process, bytes
    """
    setup = result.setup
    boundary = boundary_part(setup) | {"max_displacement": result.max_displacement}
    components = [component_part(name, own) for name, own in result.components]
    seconds = dict.fromkeys(("read", "topology", "prepare", "apply", "quality", "write"), 0.0)
    return {
        **head_part(setup.grid),
        "method": method_part(setup.case.method.name, result.account),
        "boundary": boundary,
        "motion": [dataclasses.asdict(patch) for patch in result.motion],
        **quality_part(result.assessment),
        "blocks": blocks_part(setup.grid, result.assessment.blocks),
        "valid": result.valid,
        "invalid_cells": [cell_part(cell) for cell in result.assessment.invalid],
        "invalid_groups": [dataclasses.asdict(group) for group in result.assessment.groups],
        "steps": result.steps,
        "reached": result.reached,
        "attempts": [dataclasses.asdict(attempt) for attempt in result.attempts],
        "repair": None if result.repair is None else dataclasses.asdict(result.repair),
        "repaired_layers": _repaired_layers(result),
        **({"components": components} if components else {}),
        "timing": seconds | result.timing.seconds | dict(timing),
        "peak_memory_bytes": peak_memory,
        "warnings": list(result.warnings),
    }


def _repaired_layers(result: Result) -> Report | None:
    """Changes by a repair in the layers at the walls, if the grid before the repair is known."""
    if result.plain is None:
        return None
    setup = result.setup
    found = layer_changes(setup.original, setup.boundary, result.plain, result.grid.points)
    return {name: None if change is None else dataclasses.asdict(change) for name, change in found.items()}


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
        "blocks": blocks_part(grid, assessment.blocks),
        "valid": assessment.valid,
        "invalid_cells": [cell_part(cell) for cell in assessment.invalid],
        "invalid_groups": [dataclasses.asdict(group) for group in assessment.groups],
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


def blocks_part(grid: Grid, blocks: Sequence[BlockQuality]) -> list[Report]:
    """Every block, with the families of the file's patches on it, or the patches themselves if they have none."""
    families: list[dict[str, None]] = [{} for _ in blocks]
    for patch in grid.patches:
        for window in patch.windows:
            families[window.block][patch.family or patch.name] = None
    return [
        {
            "name": block.name,
            "families": sorted(names),
            "cells": block.cells,
            "invalid_cells": block.invalid_cells,
            "before": vars(block.before).copy(),
            "after": vars(block.after).copy(),
        }
        for block, names in zip(blocks, families, strict=True)
    ]


def _shape_part(grid: Grid) -> Report:
    """Measures that matter to flow solvers, with the worst cell of each."""
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
