"""The components of an overset grid in reports: each has a verdict of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Result
from meshdeform_core.wording import counted

from .parts import Report, quality_part

HEADS = ("component", "blocks", "nodes", "moving", "largest displacement", "verdict", "steps", "f_skew min")


def outcome_part(name: str, result: Result) -> Report:
    """The outcome of the deformation of one component."""
    return {
        "name": name,
        "valid": result.valid,
        "invalid_cells": result.assessment.after.invalid_cells,
        "steps": result.steps,
        "reached": result.reached,
        "attempts": [dataclasses.asdict(attempt) for attempt in result.attempts],
        "repair": None if result.repair is None else dataclasses.asdict(result.repair),
    }


def component_part(name: str, result: Result) -> Report:
    """The outcome for one component, with its size, motion and quality."""
    grid = result.setup.grid
    return {
        **outcome_part(name, result),
        "blocks": list(grid.names),
        "nodes": grid.n_nodes,
        "cells": grid.n_cells,
        "moving_nodes": result.setup.boundary.count(Kind.MOVING),
        "max_displacement": result.max_displacement,
        **quality_part(result.assessment),
    }


def component_rows(report: Report) -> list[tuple[str | int | float, ...]]:
    """The components as rows of a table with the columns ``HEADS``."""
    return [
        (
            part["name"], len(part["blocks"]), part["nodes"], part["moving_nodes"], part["max_displacement"],
            _verdict(part), part["steps"], part["quality"]["after"]["f_skew"]["min"],
        )
        for part in report.get("components", ())
    ]  # fmt: skip


def component_lines(report: Report) -> Iterator[str]:
    """The components as text."""
    for number, part in enumerate(report.get("components", ())):
        lead = "" if number else "parts"
        moves = f"moves by up to {part['max_displacement']:.6g}" if part["moving_nodes"] else "rests"
        yield (
            f"{lead:9s} {part['name']}: {counted(len(part['blocks']), 'block')}, {part['nodes']:,} nodes; {moves}; "
            f"{_verdict(part)}; smallest f_skew {part['quality']['after']['f_skew']['min']:.4g}"
        )


def _verdict(part: Report) -> str:
    if part["reached"] < 1.0:
        return f"INVALID, {part['reached']:.1%} of the motion imposed"
    how = f"{counted(part['steps'], 'step')}{', repaired' if part['repair'] else ''}"
    return f"valid, {how}" if part["valid"] else f"INVALID, {counted(part['invalid_cells'], 'cell')}, {how}"
