"""The page: sections in the order of a reader's questions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files

from meshdeform_core.wording import counted

from ..figures import Figure
from ..parts import Report
from .figures import figure_lines
from .levels import level_tiles, levels_section
from .sections import (
    attempts_section,
    blocks_section,
    boundary_section,
    components_section,
    method_section,
    quality_section,
    run_section,
    shape_section,
    tiles,
    timing_section,
    warnings_section,
)
from .verdict import cells_section, verdict_section

Section = tuple[str, str, str]
"""Anchor, heading, html."""


def as_html(
    report: Report,
    figures: Sequence[Figure] = (),
    thumbnails: Sequence[tuple[Figure, str]] = (),
    folder: str = "",
) -> str:
    """The report as a self-contained page.

    Parameters
    ----------
    figures : pictures of a deformation, shown after the verdict
    thumbnails : of levels of a series, each with the name of its file
    folder : of the levels, relative to the page
    """
    parts = [part for part in _sections(report, figures, thumbnails, folder) if part[2]]
    name = str(report["grid"]["file"] or "grid")
    here = files(__package__)
    style, script = (here.joinpath(file).read_text(encoding="utf-8") for file in ("style.css", "script.js"))
    links = "".join(f'<li><a href="#{anchor}">{heading}</a></li>' for anchor, heading, _ in parts)
    body = "".join(f'<section id="{anchor}"><h2>{heading}</h2>{html}</section>' for anchor, heading, html in parts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(_title(report, name))}</title><style>\n{style}</style></head><body>"
        f"<header><h1>{escape(_title(report, name))}</h1>{_about(report)}</header><main>"
        f"{verdict_section(report)}{_tiles(report)}"
        f'<nav aria-label="Sections"><ul>{links}</ul></nav>\n{body}</main>'
        f"<footer>meshdeform {escape(report['meshdeform'])}, report schema {report['schema']}</footer>"
        f"<script>\n{script}</script></body></html>\n"
    )


def _title(report: Report, name: str) -> str:
    if "levels" in report:
        return f"Series of {len(report['levels'])} levels: {name}"
    return f"{'Deformation' if 'method' in report else 'Quality'} of {name}"


def _about(report: Report) -> str:
    grid = report["grid"]
    kind = f"{grid['format']}, " if grid["format"] else ""
    return (
        f'<p class="soft">{escape(kind)}{grid["dimension"]}-D, {counted(grid["blocks"], "block")}, '
        f"{grid['nodes']:,} nodes, {counted(grid['cells'], 'cell')}</p>"
    )


def _tiles(report: Report) -> str:
    if "levels" in report:
        return tiles(level_tiles(report))
    before, after = (report["quality"][when]["f_skew"] for when in ("before", "after"))
    if "method" not in report:
        return tiles([("f_skew minimum", f"{after['min']:.4f}"), ("f_skew mean", f"{after['mean']:.4f}")])
    return tiles(
        [
            ("f_skew minimum", f"{before['min']:.3f} → {after['min']:.3f}"),
            ("f_skew mean", f"{before['mean']:.3f} → {after['mean']:.3f}"),
            ("largest displacement", f"{report['boundary']['max_displacement']:.5g}"),
            ("method, steps", f"{report['method']['name']}, {report['steps']}"),
            ("seconds", f"{report['timing']['total']:.2f}"),
        ]
    )


def _sections(
    report: Report, figures: Sequence[Figure], thumbnails: Sequence[tuple[Figure, str]], folder: str
) -> Iterator[Section]:
    series = "levels" in report
    if figures:
        html = "".join(line for n, figure in enumerate(figures) for line in figure_lines(figure, n))
        yield "pictures", "Pictures", html
    if series:
        yield "levels", "Levels", levels_section(report, thumbnails, folder)
    else:
        yield "cells", "Invalid cells", cells_section(report)
        yield "quality", "Quality", quality_section(report)
    if report.get("components"):
        yield "components", "Components", components_section(report)
    if report.get("shape"):
        yield "shape", "Shape of cells", shape_section(report)
    if len(report.get("attempts") or ()) > 1 or report.get("repair"):
        yield "attempts", "Attempts", attempts_section(report)
    if report.get("blocks"):
        yield "blocks", "Blocks", blocks_section(report)
    if report["warnings"]:
        yield "warnings", "Warnings", warnings_section(report)
    if "boundary" in report:
        yield "boundary", "Boundary and motion", boundary_section(report)
    if "method" in report:
        yield "method", "Method", method_section(report)
    if "timing" in report:
        yield "time", "Time and memory", timing_section(report)
    if report.get("run"):
        yield "run", "Run", run_section(report)
