"""The text output of ``meshdeform info``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from meshdeform_core.wording import counted

_MAX_LISTED = 24
"""Largest number of unnamed faces that are listed one by one; more are summarised by role."""


def as_text(facts: dict[str, Any], verbose: bool = False) -> str:
    """The facts of :func:`meshdeform_cli.commands.info.gather` as lines; ``verbose``: every patch and face."""
    lines = [*_head(facts), "", *_blocks(facts, verbose), "", *_surfaces(facts["surfaces"], verbose)]
    if verbose and facts["patches"]:
        lines += ["", f"patches ({len(facts['patches'])})", *(f"  {_patch(patch)}" for patch in facts["patches"])]
    lines += ["", *_interfaces(facts, verbose)]
    lines += [f"collapsed  {each['face']}: {each['quads']:,} quads with {each['what']}" for each in facts["collapsed"]]
    if facts["fields"]:
        lines.append(f"fields     {', '.join(facts['fields'])}")
    lines += [f"note       {note}" for note in facts["notes"]]
    return "\n".join(lines)


def _head(facts: dict[str, Any]) -> list[str]:
    thin = facts["thin_direction"]
    layer = ""
    if thin is not None and facts["dimension"] == 3:
        layer = f", one cell thick along {_direction(thin)}"
    return [
        f"{facts['file']}: {facts['format']}",
        f"{facts['dimension']}-D{layer}, {counted(len(facts['blocks']), 'block')}, {facts['nodes']:,} nodes "
        f"({facts['unique_nodes']:,} unique), {counted(facts['cells'], 'cell')}",
        f"extent {_box(facts['bounding_box'])}, shortest edge on a block face {facts['shortest_face_edge']:.3g}",
    ]


def _blocks(facts: dict[str, Any], verbose: bool) -> list[str]:
    blocks = facts["blocks"]
    width = max(len(b["name"]) for b in blocks)
    sizes = [" x ".join(str(n) for n in b["nodes"]) for b in blocks]
    wide = max(len(size) for size in sizes)
    lines = [
        f"  {b['name']:{width}s}  {size:{wide}s}  {b['handedness']}-handed  {_box(b['bbox'])}"
        for b, size in zip(blocks, sizes, strict=True)
    ]
    return ["blocks", *_listed(lines, verbose)]


def _listed(lines: list[str], verbose: bool) -> list[str]:
    """All lines, or the first ones and how many more there are."""
    if verbose or len(lines) <= _MAX_LISTED:
        return lines
    return [*lines[: _MAX_LISTED - 1], f"  ... and {len(lines) - _MAX_LISTED + 1} more (-v shows all)"]


def _surfaces(surfaces: list[dict[str, Any]], verbose: bool) -> list[str]:
    nameless = [s for s in surfaces if not s["named"]]
    if not verbose and len(nameless) > _MAX_LISTED:
        surfaces = [*(s for s in surfaces if s["named"]), *_by_role(nameless)]
    order = {role: n for n, role in enumerate(("wall", "symmetry", "end", "far", "unknown"))}
    surfaces = sorted(surfaces, key=lambda s: order.get(s["role"], 9))
    rows = [("", "role", "quads", "area", "first cell (min, median)", "extent")]
    for s in surfaces:
        mark = "" if s["declared"] or s["role"] == "unknown" else "?"
        height = s["first_cell_height"]
        rows.append(
            (
                _title(s), f"{s['role']}{mark}", f"{s['quads']:,}", f"{s['area']:.4g}",
                f"{height['min']:.3g}, {height['median']:.3g}", _box(s["bbox"]),
            )
        )  # fmt: skip
    lines = ["boundaries ('?': guessed from the shape of the grid)", *_table(rows)]
    return lines if rows[1:] else ["boundaries (none: every face is shared)"]


def _by_role(surfaces: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Unnamed faces, one entry per role."""
    merged = []
    for role in dict.fromkeys(s["role"] for s in surfaces):
        mine = [s for s in surfaces if s["role"] == role]
        corners = list(zip(*(s["bbox"] for s in mine), strict=True))
        merged.append(
            {
                **mine[0],
                "name": f"{len(mine)} faces",
                "faces": [face for s in mine for face in s["faces"]],
                "quads": sum(s["quads"] for s in mine),
                "area": sum(s["area"] for s in mine),
                "bbox": [[f(c) for c in zip(*ends, strict=True)] for f, ends in zip((min, max), corners, strict=True)],
                "first_cell_height": {
                    "min": min(s["first_cell_height"]["min"] for s in mine),
                    "median": sorted(s["first_cell_height"]["median"] for s in mine)[len(mine) // 2],
                },
            }
        )
    return merged


def _title(surface: dict[str, Any]) -> str:
    patches = [name for name in surface["patches"] if name != surface["name"]]
    if not surface["named"]:
        return str(surface["name"])
    if not patches:
        return f"{surface['name']} ({counted(len(surface['faces']), 'face')})"
    return f"{surface['name']} ({counted(len(surface['patches']), 'patch', 'patches')})"


def _interfaces(facts: dict[str, Any], verbose: bool) -> list[str]:
    found = facts["interfaces"]
    lines = [f"  {f['name']}  {_node(f['first'])}..{_node(f['last'])}  transform {f['transform']}" for f in found]
    head = f"interfaces ({len(found)} found, {facts['declared_connections']} declared in the file)"
    return [head, *_listed(lines, verbose)]


def _patch(patch: dict[str, Any]) -> str:
    where = ", ".join(f"{w['face']}[{_window(w)}]" for w in patch["windows"])
    kind = ", ".join(word for word in (patch["family"], patch["type"]) if word)
    return f"{patch['name']}  ({kind or 'no type'})  {where}"


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Columns of equal width; numbers right-aligned."""
    widths = [max(len(row[n]) for row in rows) for n in range(len(rows[0]))]
    right = {2, 3}
    return [
        ("  " + "  ".join(f"{cell:>{w}s}" if n in right else f"{cell:{w}s}" for n, (cell, w) in
                          enumerate(zip(row, widths, strict=True)))).rstrip()
        for row in rows
    ]  # fmt: skip


def _window(window: dict[str, Any]) -> str:
    return ",".join(f"{a}:{b}" for a, b in zip(window["first"], window["last"], strict=True))


def _node(node: list[int]) -> str:
    return f"({', '.join(str(n) for n in node)})"


def _box(box: list[list[float]]) -> str:
    size = max(abs(v) for end in box for v in end)
    return "  ".join(f"{name} {_range(a, b, size)}" for name, a, b in zip("xyz", *box, strict=True))


def _range(low: float, high: float, size: float) -> str:
    # Values within round-off of the other coordinates count as 0.
    low, high = (0.0 if abs(v) < 1e-9 * size else v for v in (low, high))
    return f"{low:.5g}" if high - low <= 1e-9 * size else f"{low:.5g}..{high:.5g}"


def _direction(normal: list[float]) -> str:
    for name, component in zip("xyz", normal, strict=True):
        if abs(component) > 1 - 1e-6:
            return name
    return f"({', '.join(f'{c:.3g}' for c in normal)})"
