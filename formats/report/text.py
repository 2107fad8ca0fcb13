"""Reports as plain text."""

from __future__ import annotations

from collections.abc import Iterator

from meshdeform_core.memory import readable
from meshdeform_core.wording import counted

from .measures import measure_rows, place_text
from .records import Report
from .repaired import repair_lines
from .series_text import series_lines
from .tables import component_verdict, is_alone, number

_LISTED = 20
_ALONG = 0.9994
_SHAPE_NAMES = {"non_orthogonality_deg": "non-orthogonality [deg]"}


def as_text(report: Report, parameters: bool = True) -> str:
    """The report, section by section, the verdict first; with or without the parameters of the method."""
    return "\n".join(_lines(report, parameters)) + "\n"


def _lines(report: Report, parameters: bool) -> Iterator[str]:
    if "valid" in report:
        yield from _verdict(report)
    grid = report["grid"]
    yield f"grid      {grid['file'] or '(in memory)'}: {grid['format'] or _no_format(grid)}"
    yield (
        f"          {grid['dimension']}-D, {counted(grid['blocks'], 'block')}, {grid['nodes']:,} nodes, "
        f"{counted(grid['cells'], 'cell')}"
    )
    if "method" in report:
        yield f"method    {report['method']['name']}" + ("" if parameters else "  (-v shows its parameters)")
    if "boundary" in report:
        yield from _boundary(report["boundary"])
        yield from _motion(report.get("motion", []))
    yield from _components(report)
    if "levels" in report:
        yield from series_lines(report)
    elif "quality" in report:
        yield from _quality(report)
        yield from _repair(report)
    if parameters and "method" in report:
        yield from _parameters(report["method"])
    if "expected" in report:
        yield _expected(report["expected"])
    if "timing" in report:
        timing = report["timing"]
        yield "seconds   " + "  ".join(f"{name} {value:.2f}" for name, value in timing.items())
        yield f"memory    {readable(report['peak_memory_bytes'])} at most"
    for warning in report["warnings"]:
        yield f"warning   {warning}"


def _expected(expense: Report) -> str:
    """The forecast of a run's memory and disk space."""
    work, output = expense["work_bytes"], expense["output_bytes"]
    used = [f"{readable(work)} of files to work in"] if work else []
    used += [f"{readable(output)} for the output"] if output else []
    disk = f"; disk {' and '.join(used)}" if used else ""
    bound = "at most " if expense["bound"] else ""
    each = f" on each of {expense['ranks']} ranks" if expense["ranks"] > 1 else ""
    return f"expected  memory {bound}{readable(expense['memory_bytes'])}{each}{disk}"


def _no_format(grid: Report) -> str:
    return "several files" if grid["file"] else "no file"


def _verdict(report: Report) -> Iterator[str]:
    """Whether the grid is valid, how it was obtained, and its invalid cells."""
    yield f"verdict   {'valid' if report['valid'] else 'INVALID'}"
    cells = report.get("invalid_cells", [])
    for cell in cells[:_LISTED]:
        i, j, k = cell["ijk"]
        near = f", nearest patch {cell['nearest_patch']}" if cell["nearest_patch"] else ""
        yield (
            f"          {cell['block']} ({i}, {j}, {k}): Jacobian {cell['min_jacobian']:.3g}, step {cell['step']}{near}"
        )
    if len(cells) > _LISTED:
        yield f"          ... {len(cells) - _LISTED} more in the json report"
    if "steps" in report:
        reached = "" if report["reached"] == 1.0 else f", {report['reached']:.1%} of the motion imposed"
        repaired = ", then repaired (below)" if report.get("repair") and "quality" in report else ""
        yield f"steps     {report['steps']}{reached}{repaired}"
        if "quality" in report:
            yield f"worst     {', '.join(_worst(report['quality']['after']))}"
    if new := report.get("new_interior"):
        yield (
            f"interior  remade from the reference by {new['method']} in {counted(new['steps'], 'step')}: "
            f"{new['reason']}"
        )
    if "quality" not in report:
        yield from _repair(report)


def _worst(after: Report) -> Iterator[str]:
    """What a user decides by: the worst cells, and the cells at walls."""
    yield f"smallest scaled Jacobian {after['min_scaled_jacobian']:.3g}"
    yield f"smallest f_skew {after['f_skew']['min']:.3g}"
    if after["wall_normal_deviation_deg"]:
        yield f"grid lines at walls turned by up to {after['wall_normal_deviation_deg']['max']:.3g} degrees"
    if heights := after["first_cell_height_ratio"]:
        yield f"first cells {heights['min']:.3g} to {heights['max']:.3g} times as high"


def _repair(report: Report) -> Iterator[str]:
    for index, done in enumerate(repair_lines(report)):
        yield f"{'' if index else 'repair':9s} {done}"


def _parameters(method: Report) -> Iterator[str]:
    for index, (name, setting) in enumerate((key, value) for key, value in method.items() if key != "name"):
        lead = "settings" if index == 0 else ""
        reason = f"  ({setting['reason']})" if "reason" in setting else ""
        yield f"{lead:9s} {name} = {number(setting['value'])}{reason}"


def _boundary(boundary: Report) -> Iterator[str]:
    patches = boundary["patches"]
    width = max(len(p["name"]) for p in patches)
    for index, patch in enumerate(patches):
        lead = "boundary" if index == 0 else ""
        yield f"{lead:9s} {patch['name']:{width}s}  {patch['kind']:9s} {patch['nodes']:>10,} nodes"
    counts = [f"{boundary[key]:,} {key.split('_')[0]}" for key in boundary if key.endswith("_nodes")]
    yield f"nodes     {', '.join(counts)}"
    for match in boundary.get("matches", ()):
        yield (
            f"table     {match['table']}: {_fitted(match)}{match['matched_nodes']:,} nodes matched ({match['match']}, "
            f"at most {match['max_distance']:.3g} away), {match['unmatched_nodes']:,} not; "
            f"{match['table_points_used']:,} of {match['table_points']:,} table points used"
        )
    if "max_displacement" in boundary:
        yield f"motion    largest displacement {boundary['max_displacement']:.6g}"


def _fitted(match: Report) -> str:
    """The walls that a table was found to fit."""
    names = ", ".join(repr(name) for name in match["walls"])
    return f"fits {names}; " if names else ""


def _motion(patches: list[Report]) -> Iterator[str]:
    """The motion as evaluated, which reveals, for instance, radians given as degrees."""
    for patch in patches:
        mean = ", ".join(f"{part:.4g}" for part in patch["mean_displacement"])
        yield (
            f"          {patch['boundary']}: up to {patch['max_displacement']:.6g}, mean ({mean}), "
            f"rotated by up to {patch['max_rotation_deg']:.4g} degrees{axis_text(patch['rotation_axis'])}"
        )


def axis_text(axis: list[float]) -> str:
    """`` about +z``: the axis of a right-handed rotation, as a coordinate axis if it is one within 2 degrees."""
    if not any(axis):
        return ""
    for name, part in zip("xyz", axis, strict=True):
        if abs(part) > _ALONG:
            return f" about {'+' if part > 0 else '-'}{name}"
    return f" about ({', '.join(f'{part:.3g}' for part in axis)})"


def _components(report: Report) -> Iterator[str]:
    """The components of an overset grid, each with its verdict."""
    for part_number, part in enumerate(report.get("components", ())):
        lead = "" if part_number else "parts"
        moves = f"moves by up to {part['max_displacement']:.6g}" if part["moving_nodes"] else "rests"
        yield (
            f"{lead:9s} {part['name']}: {counted(len(part['blocks']), 'block')}, {part['nodes']:,} nodes; {moves}; "
            f"{component_verdict(part)}; smallest f_skew {part['quality']['after']['f_skew']['min']:.4g}"
        )


def _quality(report: Report) -> Iterator[str]:
    # A grid by itself has nothing to compare with: one column.
    alone = is_alone(report)
    heads = ("",) if alone else ("before", "after")
    yield f"{'quality':9s} {'':34s}" + "".join(f" {head:>14s}" for head in heads)
    for row in measure_rows(report["quality"]):
        if alone and row.compared:
            continue
        values = (row.after,) if alone else (row.before, row.after)
        columns = "".join(f" {number(value):>14s}" for value in values)
        yield f"{'':9s} {row.name:34s}{columns}" + (f"  at {row.place}" if row.place else "")
    if "shape" in report:
        yield from _shape(report["shape"], alone)


def _shape(shape: Report, alone: bool) -> Iterator[str]:
    """Largest value of every measure of shape, and its position."""
    for name, after in shape["after"].items():
        before = (shape["before"] or {}).get(name)
        values = (after,) if alone else (before, after)
        label = f"largest {_SHAPE_NAMES.get(name, name.replace('_', ' '))}"
        columns = "".join(f" {number(v['max']) if v else '':>14s}" for v in values)
        yield f"{'':9s} {label:34s}{columns}  at {place_text(after['worst'])}"
