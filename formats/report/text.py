"""Reports as plain text."""

from __future__ import annotations

from collections.abc import Iterator

from meshdeform_core.memory import readable
from meshdeform_core.wording import counted

from .measures import place_text
from .records import Report
from .tables import (
    ACCELERATION,
    acceleration_of,
    component_verdict,
    is_alone,
    measures_table,
    number,
    repair_lines,
    repaired,
    shape_table,
)

_LISTED = 20
_ALONG = 0.9994
_ORIGINS = {"reference": "undeformed grid", "last": "previous level (marching)"}
_SHAPE_NAMES = {
    "non_orthogonality_deg": "largest non-orthogonality [deg]",
    "face_pyramids": "wrong face pyramids (checkMesh)",
}


def as_text(report: Report, parameters: bool = True) -> str:
    """The report, section by section, the verdict first; with or without the parameters of the method."""
    return "\n".join(_report_lines(report, parameters)) + "\n"


def _report_lines(report: Report, parameters: bool) -> Iterator[str]:
    if "valid" in report:
        yield from _verdict_lines(report)
    grid = report["grid"]
    kind = grid["format"] or ("several files" if grid["file"] else "no file")
    yield f"grid      {grid['file'] or '(in memory)'}: {kind}"
    yield (
        f"          {grid['dimension']}-D, {counted(grid['blocks'], 'block')}, {grid['nodes']:,} nodes, "
        f"{counted(grid['cells'], 'cell')}"
    )
    if "method" in report:
        yield f"method    {report['method']['name']}" + ("" if parameters else "  (-v shows its parameters)")
    if "boundary" in report:
        yield from _boundary_lines(report["boundary"], report.get("motion", []))
    for index, part in enumerate(report.get("components", ())):
        moves = f"moves by up to {part['max_displacement']:.6g}" if part["moving_nodes"] else "rests"
        yield (
            f"{'' if index else 'parts':9s} {part['name']}: {counted(len(part['blocks']), 'block')}, "
            f"{part['nodes']:,} nodes; {moves}; {component_verdict(part)}; "
            f"smallest f_skew {part['quality']['after']['f_skew']['min']:.4g}"
        )
    if "levels" in report:
        yield from _level_lines(report)
    elif "quality" in report:
        yield from _quality_lines(report)
        yield from _repair_lines(report)
    settings = [(key, value) for key, value in report.get("method", {}).items() if key != "name"] if parameters else []
    for index, (name, setting) in enumerate(settings):
        reason = f"  ({setting['reason']})" if "reason" in setting else ""
        yield f"{'' if index else 'settings':9s} {name} = {number(setting['value'])}{reason}"
    if "expected" in report:
        yield _expected(report["expected"])
    if "timing" in report:
        yield "seconds   " + "  ".join(f"{name} {value:.2f}" for name, value in report["timing"].items())
        yield f"memory    {readable(report['peak_memory_bytes'])} at most"
    for warning in report["warnings"]:
        yield f"warning   {warning}"


def _expected(expense: Report) -> str:
    """The forecast of a run's memory and disk space."""
    work, output = expense["work_bytes"], expense["output_bytes"]
    used = [f"{readable(work)} of files to work in"] if work else []
    used += [f"{readable(output)} for the output"] if output else []
    disk = f"; disk {' and '.join(used)}" if used else ""
    each = f" on each of {expense['ranks']} ranks" if expense["ranks"] > 1 else ""
    return f"expected  memory {readable(expense['memory_bytes'])}{each}{disk}"


def _verdict_lines(report: Report) -> Iterator[str]:
    """Whether the grid is valid, how it was obtained, and its invalid cells."""
    yield f"verdict   {'valid' if report['valid'] else 'INVALID'}"
    cells = report.get("invalid_cells", [])
    for cell in cells[:_LISTED]:
        near = f", nearest patch {cell['nearest_patch']}" if cell["nearest_patch"] else ""
        yield f"          {place_text(cell)}: Jacobian {cell['min_jacobian']:.3g}, step {cell['step']}{near}"
    if len(cells) > _LISTED:
        yield f"          ... {len(cells) - _LISTED} more in the json report"
    if "steps" in report:
        reached = "" if report["reached"] == 1.0 else f", {report['reached']:.1%} of the motion imposed"
        done = ", then repaired (below)" if repaired(report) in ("yes", "other") and "quality" in report else ""
        yield f"steps     {report['steps']}{reached}{done}"
        if "quality" in report:
            yield f"worst     {', '.join(_worst_of_cells(report['quality']['after']))}"
    if new := report.get("new_interior"):
        steps = counted(new["steps"], "step")
        yield f"interior  remade from the reference by {new['method']} in {steps}: {new['reason']}"
    if "quality" not in report:
        yield from _repair_lines(report)


def _worst_of_cells(after: Report) -> Iterator[str]:
    """What a user decides by: the worst cells, and the cells at walls."""
    yield f"smallest scaled Jacobian {after['min_scaled_jacobian']:.3g}"
    yield f"smallest f_skew {after['f_skew']['min']:.3g}"
    if after["wall_normal_deviation_deg"]:
        yield f"grid lines at walls turned by up to {after['wall_normal_deviation_deg']['max']:.3g} degrees"
    if heights := after["first_cell_height_ratio"]:
        yield f"first cells {heights['min']:.3g} to {heights['max']:.3g} times as high"


def _repair_lines(report: Report) -> Iterator[str]:
    for index, done in enumerate(repair_lines(report)):
        yield f"{'' if index else 'repair':9s} {done}"


def _boundary_lines(boundary: Report, motion: list[Report]) -> Iterator[str]:
    """Entries, nodes, tables, and the motion as evaluated, which reveals, for instance, radians given as degrees."""
    patches = boundary["patches"]
    width = max(len(p["name"]) for p in patches)
    for index, patch in enumerate(patches):
        lead = "" if index else "boundary"
        yield f"{lead:9s} {patch['name']:{width}s}  {patch['kind']:9s} {patch['nodes']:>10,} nodes"
    counts = [f"{boundary[key]:,} {key.split('_')[0]}" for key in boundary if key.endswith("_nodes")]
    yield f"nodes     {', '.join(counts)}"
    for match in boundary.get("matches", ()):
        fits = f"fits {', '.join(map(repr, match['walls']))}; " if match["walls"] else ""
        yield (
            f"table     {match['table']}: {fits}{match['matched_nodes']:,} nodes matched ({match['match']}, "
            f"at most {match['max_distance']:.3g} away), {match['unmatched_nodes']:,} not; "
            f"{match['table_points_used']:,} of {match['table_points']:,} table points used"
        )
    if "max_displacement" in boundary:
        yield f"motion    largest displacement {boundary['max_displacement']:.6g}"
    for patch in motion:
        least = 1e-12 * patch["max_displacement"]
        mean = ", ".join(f"{part if abs(part) > least else 0.0:.4g}" for part in patch["mean_displacement"])
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


def _quality_lines(report: Report) -> Iterator[str]:
    """The measures, and the largest values of those of shape; of a grid by itself in one column."""
    measures, values = measures_table(report), 1 if is_alone(report) else 2
    heads = [""] if values == 1 else measures.heads[1:3]
    yield f"{'quality':9s} {'':34s}" + "".join(f" {head:>14s}" for head in heads)
    rows = [(name, found, place) for name, *found, place in measures.rows]
    for name, before, after, _, place in shape_table(report).rows if report.get("shape") else ():
        label = _SHAPE_NAMES.get(name, f"largest {name.replace('_', ' ')}")
        rows.append((label, [before, after][-values:], place))
    for name, found, place in rows:
        columns = "".join(f" {number(value):>14s}" for value in found)
        yield f"{'':9s} {name:34s}{columns}" + (f"  at {place}" if place else "")


def _level_lines(report: Report) -> Iterator[str]:
    """The levels of a series as lines of a table."""
    series, levels = report["series"], report["levels"]
    before = report["quality"]["before"]["f_skew"]
    yield f"series    {series['levels']} levels, each from the {_ORIGINS[series['origin']]}"
    if series["view"]:
        yield f"          open {series['view']} in ParaView"
    yield f"          f_skew of the undeformed grid: mean {before['harmonic_mean']:.4f}, minimum {before['min']:.4f}"
    yield (
        f"level     {'time':>12s} {'moved':>10s} {'turned':>8s} {'f_skew':>7s} {'min':>7s} {'invalid':>8s}"
        f" {'accel.':>8s} {'repaired':>8s} {'drift':>9s} {'prepare':>8s} {'apply':>8s} {'total s':>8s}"
    )
    for level in levels:
        skew, drift, timing = level["quality"]["f_skew"], level["drift"], level["timing"]
        shown = f"{drift['max']:9.2e}" if drift else f"{'':9s}"
        found = acceleration_of(level)
        acceleration = "" if found is None else f"{found:8.3f}"
        yield (
            f"{level['number']:5d}     {level['time']:12.6g} {level['max_displacement']:10.4g} "
            f"{level['max_rotation_deg']:7.2f}° {skew['harmonic_mean']:7.4f} {skew['min']:7.4f} "
            f"{level['quality']['invalid_cells']:8,} {acceleration:>8s} {repaired(level):>8s} {shown} "
            f"{timing.get('prepare', 0.0):8.2f} {timing.get('apply', 0.0):8.2f} {timing['total']:8.2f}"
        )
    if any(acceleration_of(level) is not None for level in levels):
        yield f"accel.    {ACCELERATION}"
    if series["drift"]:
        yield (
            f"drift     {series['drift']['max']:.3g} at most, {series['drift']['rms']:.3g} rms: distance of the last "
            f"level from the grid made from the undeformed one"
        )
