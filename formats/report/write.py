"""Reports as JSON, as plain text (sections with their names) or HTML, written; their provenance."""

from __future__ import annotations

import datetime
import math
import os
import platform
import shlex
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.memory import readable
from meshdeform_core.parallel import thread_count
from meshdeform_core.wording import counted

from ..files import replacing
from ..inputs import digest, files_of, size
from ..text import json_text
from . import tables
from .records import Report
from .tables import Illustrate, Table

SUFFIXES = (".json", ".txt", ".html")
_LISTED = 20
_LIBRARIES = ("numpy", "scipy", "numba")


def write_report(report: Report, path: Path, illustrate: Illustrate = tuple) -> None:
    """Write a report; the suffix selects json, txt or html. Pictures are made only for HTML.

    Raises FormatError for another suffix, or when the file cannot be written.
    """
    check_report_path(path)
    if path.suffix == ".json":
        text = as_json(report)
    elif path.suffix == ".txt":
        text = as_text(report)
    else:
        from .page import as_html

        folder = os.path.relpath(report["series"]["folder"], path.parent) if "series" in report else ""
        text = as_html(report, illustrate(), folder)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="surrogateescape")


def as_json(report: Report) -> str:
    """The report as JSON; non-finite numbers, which JSON lacks, are null."""
    return json_text(_finite(report), allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


def check_report_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix not in SUFFIXES:
        raise FormatError(f"report {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")


def run_part(arguments: Sequence[str], files: Iterable[tuple[str, Path | None]], ranks: int) -> Report:
    """The data needed to repeat a run and to verify that it is the same.

    Parameters
    ----------
    arguments : of the command line, without the program's name
    files : role and path of the files read and written; ``None`` and missing files are omitted
    ranks : number of processes that shared the work
    """
    return {
        "command": shlex.join(["meshdeform", *arguments]),
        "directory": os.getcwd(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "threads": thread_count(),
        "ranks": ranks,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}},
        "files": [
            {"role": role, "path": str(path), "bytes": size(path), "sha256": digest(path)}
            for role, path in files
            if path is not None and files_of(path) and path.exists()
        ],
    }


def as_text(report: Report, parameters: bool = True) -> str:
    """The report, section by section, the verdict first; with or without the parameters of the method."""
    found = []
    for name, lines in _sections(report, parameters):
        found += [f"{'' if index else name:9s} {line}".rstrip() for index, line in enumerate(lines)]
    return "\n".join(found) + "\n"


def _sections(report: Report, parameters: bool) -> Iterator[tuple[str, Iterable[str]]]:
    grid, judged = report["grid"], "quality" in report and "levels" not in report
    if "valid" in report:
        yield from _verdict_lines(report, judged)
    kind = grid["format"] or ("several files" if grid["file"] else "no file")
    size = f"{grid['dimension']}-D, {counted(grid['blocks'], 'block')}, {grid['nodes']:,} nodes"
    yield "grid", (f"{grid['file'] or '(in memory)'}: {kind}", f"{size}, {counted(grid['cells'], 'cell')}")
    if "method" in report:
        yield "method", [report["method"]["name"] + ("" if parameters else "  (-v shows its parameters)")]
    if "boundary" in report:
        yield "boundary", _columns(tables.boundary_table(report["boundary"]))
        yield "nodes", [tables.node_counts(report["boundary"])]
        yield "table", tables.match_lines(report["boundary"])
        yield "motion", tables.motion_lines(report)
    if report.get("components"):
        yield "parts", _columns(tables.components_table(report))
    if "levels" in report:
        series, before = report["series"], report["quality"]["before"]["f_skew"]
        lines = [f"{series['levels']} levels, each from the undeformed grid"]
        lines += [f"open {series['view']} in ParaView"] if series["view"] else []
        lines.append(f"f_skew before: mean {before['mean']:.4f}, minimum {before['min']:.4f}")
        yield "series", lines
        yield "levels", _columns(tables.levels_table(report))
        if any(tables.acceleration_of(level) is not None for level in report["levels"]):
            yield "accel.", [tables.ACCELERATION]
    elif judged:
        yield "quality", _columns(tables.measures_table(report))
        if report.get("shape"):
            yield "shape", _columns(tables.shape_table(report))
        yield "repair", tables.repair_lines(report)
    if parameters and len(report.get("method", ())) > 1:
        yield "settings", _columns(tables.settings_table(report))
    if "expected" in report:
        # The forecast of a run's memory and disk space.
        expense = report["expected"]
        kinds = ((expense["work_bytes"], "of files to work in"), (expense["output_bytes"], "for the output"))
        disk = " and ".join(f"{readable(size)} {what}" for size, what in kinds if size)
        each = f" on each of {expense['ranks']} ranks" if expense["ranks"] > 1 else ""
        memory = f"memory {readable(expense['memory_bytes'])}{each}"
        yield "expected", [f"{memory}; disk {disk}" if disk else memory]
    if "timing" in report:
        yield "seconds", ["  ".join(f"{name} {value:.2f}" for name, value in report["timing"].items())]
        yield "memory", [f"{readable(report['peak_memory_bytes'])} at most"]
    for warning in report["warnings"]:
        yield "warning", [warning]


def _columns(table: Table) -> Iterator[str]:
    """A table with aligned columns, numbers to the right."""
    rows = [table.heads, *([tables.number(value) for value in row] for row in table.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = zip(row, widths, strict=True)
        yield "  ".join(f"{cell:{'<' if n in table.texts else '>'}{width}s}" for n, (cell, width) in enumerate(cells))


def _verdict_lines(report: Report, judged: bool) -> Iterator[tuple[str, Iterable[str]]]:
    """Whether the grid is valid, how it was obtained, its invalid cells, and what a user decides by."""
    cells, lines = report.get("invalid_cells", []), ["valid" if report["valid"] else "INVALID"]
    for cell in cells[:_LISTED]:
        near = f", nearest patch {cell['nearest_patch']}" if cell["nearest_patch"] else ""
        lines.append(f"{tables.place_text(cell)}: Jacobian {cell['min_jacobian']:.3g}, step {cell['step']}{near}")
    if len(cells) > _LISTED:
        lines.append(f"... {len(cells) - _LISTED} more in the json report")
    yield "verdict", lines
    if "steps" in report:
        reached = "" if report["reached"] == 1.0 else f", {report['reached']:.1%} of the motion imposed"
        done = ", then repaired (below)" if tables.repaired(report) in ("yes", "other") and judged else ""
        yield "steps", [f"{report['steps']}{reached}{done}"]
    if "steps" in report and judged:
        after = report["quality"]["after"]
        worst = f"smallest scaled Jacobian {after['min_scaled_jacobian']:.3g}"
        worst += f", smallest f_skew {after['f_skew']['min']:.3g}"
        if after["wall_normal_deviation_deg"]:
            worst += f", grid lines at walls turned by up to {after['wall_normal_deviation_deg']['max']:.3g} degrees"
        if heights := after["first_cell_height_ratio"]:
            worst += f", first cells {heights['min']:.3g} to {heights['max']:.3g} times as high"
        yield "worst", [worst]
    if new := report.get("new_interior"):
        steps = counted(new["steps"], "step")
        yield "interior", [f"remade from the reference by {new['method']} in {steps}: {new['reason']}"]
    if "quality" not in report:
        yield "repair", tables.repair_lines(report)
