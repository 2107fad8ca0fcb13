"""What reports in several forms have in common: the quality measures, tables, sentences on repairs, pictures."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from meshdeform_core.wording import counted

from .records import Report

ACCELERATION = "largest acceleration of a node, in the largest step of the walls; 2 where they turn back"
_ALONG = 0.9994
_WEAK = "weak: sheared by more than 45 degrees, or twice or half as long in one direction"


_RMS, _RANGE = ("rms", "max"), ("min", "max")
_MEASURES: tuple[tuple[str, tuple[str, ...], tuple[str, ...], bool], ...] = (
    ("f_skew harmonic mean", ("f_skew", "harmonic_mean"), (), False),
    ("f_skew mean", ("f_skew", "mean"), (), False),
    ("f_skew 1% quantile", ("f_skew", "p01"), (), False),
    ("f_skew minimum", ("f_skew", "min"), (), False),
    ("smallest scaled Jacobian", ("min_scaled_jacobian",), (), False),
    ("smallest relative Jacobian", ("min_relative_jacobian",), (), True),
    ("invalid cells", ("invalid_cells",), (), False),
    ("inherited invalid cells", ("inherited_invalid_cells",), (), False),
    ("negative volumes", ("negative_volumes",), (), False),
    ("wall-normal deviation {} [deg]", ("wall_normal_deviation_deg",), _RMS, False),
    ("first cell height ratio {}", ("first_cell_height_ratio",), _RANGE, True),
    ("layer thickness ratio {}", ("walls", "moving", "layer_thickness_ratio"), _RANGE, True),
    ("fixed walls: normal deviation {} [deg]", ("walls", "fixed", "wall_normal_deviation_deg"), _RMS, False),
    ("fixed walls: first cell ratio {}", ("walls", "fixed", "first_cell_height_ratio"), _RANGE, True),
    ("fixed walls: layer ratio {}", ("walls", "fixed", "layer_thickness_ratio"), _RANGE, True),
    ("interface kink {} [deg]", ("interface_kink_deg",), _RMS, False),
    ("interface spacing jump {}", ("interface_spacing_jump",), _RMS, False),
    ("volume ratio {}", ("volume_ratio",), _RANGE, True),
    ("total volume", ("total_volume",), (), False),
)
"""Name, keys in the report, the ends of a measure that has some, and whether it compares with another grid."""
# Measures to which all cells contribute, so that they have no worst cell.
_OF_ALL = ("harmonic_mean", "mean", "p01", "rms")


def place_text(worst: Mapping[str, Any]) -> str:
    """Block and indices of a cell."""
    return f"{worst['block']} ({', '.join(map(str, worst['ijk']))})"


@dataclass(frozen=True)
class Table:
    """Rows of texts and numbers (``None``: no value).

    ``texts`` are numbers of columns of texts, all others hold numbers; ``flagged`` numbers of the rows to highlight.
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Any]]
    texts: Sequence[int] = (0,)
    flagged: Sequence[int] = ()


def number(value: Any) -> str:
    """A formatted value: six digits, thousands separated; texts as they are, nothing for ``None``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "" if value is None else str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def is_alone(report: Report) -> bool:
    """Whether a grid was judged by itself: it has nothing to be compared with."""
    return "reference" in report and report["reference"] is None


def measures_table(report: Report) -> Table:
    """Every measure that the quality of a report has, with the position of the worst cell."""
    alone, rows, flagged, quality = is_alone(report), list[tuple[Any, ...]](), list[int](), report["quality"]
    measures = ((*measure, end) for measure in _MEASURES for end in measure[2] or ("",))
    for name, keys, _, compared, end in measures:
        keys = (*keys, end) if end else keys
        before, after = (
            functools.reduce(lambda found, key: None if found is None else found.get(key), keys, quality[when])
            for when in ("before", "after")
        )
        if after is None or (alone and compared):
            continue
        part, own = quality["after"], keys
        if keys[0] == "walls":
            part, own = part["walls"][keys[1]], keys[2:]
        places = part.get("worst") or {}
        worst = None if own[-1] in _OF_ALL else places.get("_".join(own)) or places.get(own[0])
        flagged += [len(rows)] if name == "invalid cells" and after else []
        rows.append((name.format(end), *(() if alone else (before,)), after, place_text(worst) if worst else ""))
    heads = ("value",) if alone else ("before", "after")
    caption = "Quality measures; f_skew is Knupp's skew measure: 1 orthogonal, 0 invalid"
    return Table(caption, ("measure", *heads, "worst at"), rows, (0, len(heads) + 1), flagged)


def shape_table(report: Report) -> Table:
    """Measures that matter to flow solvers, with the position of the largest."""
    rows, original = [], report["shape"]["before"]
    for name, after in report["shape"]["after"].items():
        place, shown = after.get("worst"), "wrong" if name == "face_pyramids" else "max"
        before = [] if original is None else [original[name][shown]]
        where = place_text(place) if place and after[shown] else ""
        rows.append((name, *before, after[shown], after.get("mean"), where))
    heads = ("measure", *(() if original is None else ("largest before",)), "largest", "mean", "largest at")
    return Table("Measures that matter to flow solvers", heads, rows, (0, len(heads) - 1))


def boundary_table(boundary: Report) -> Table:
    """The entries of the boundary."""
    rows = [(patch["name"], patch["kind"], patch["nodes"]) for patch in boundary["patches"]]
    return Table("Boundary entries", ("name", "kind", "nodes"), rows, (0, 1))


def node_counts(boundary: Report) -> str:
    """Numbers of nodes by kind."""
    return ", ".join(f"{boundary[key]:,} {key.removesuffix('_nodes')}" for key in boundary if key.endswith("_nodes"))


def match_lines(boundary: Report) -> list[str]:
    """How each displacement table was used."""
    lines = []
    for match in boundary.get("matches", ()):
        fits = f"fits {', '.join(map(repr, match['walls']))}; " if match["walls"] else ""
        lines.append(
            f"{match['table']}: {fits}{match['matched_nodes']:,} nodes matched ({match['match']}, "
            f"at most {match['max_distance']:.3g} away), {match['unmatched_nodes']:,} not; "
            f"{match['table_points_used']:,} of {match['table_points']:,} table points used"
        )
    return lines


def motion_lines(report: Report) -> list[str]:
    """The motion as evaluated, which reveals, for instance, radians given as degrees."""
    if "max_displacement" not in report["boundary"]:
        return []
    lines = [f"largest displacement {report['boundary']['max_displacement']:.6g}"]
    for patch in report.get("motion", ()):
        least = 1e-12 * patch["max_displacement"]
        mean = ", ".join(f"{part if abs(part) > least else 0.0:.4g}" for part in patch["mean_displacement"])
        lines.append(
            f"{patch['boundary']}: up to {patch['max_displacement']:.6g}, mean ({mean}), "
            f"rotated by up to {patch['max_rotation_deg']:.4g} degrees{axis_text(patch['rotation_axis'])}"
        )
    return lines


def axis_text(axis: list[float]) -> str:
    """`` about +z``: the axis of a right-handed rotation, as a coordinate axis if it is one within 2 degrees."""
    if not any(axis):
        return ""
    for name, part in zip("xyz", axis, strict=True):
        if abs(part) > _ALONG:
            return f" about {'+' if part > 0 else '-'}{name}"
    return f" about ({', '.join(f'{part:.3g}' for part in axis)})"


def settings_table(report: Report) -> Table:
    """The parameters of the method."""
    settings = ((name, setting) for name, setting in report["method"].items() if name != "name")
    rows = [(name, number(each["value"]), each.get("reason", "given or default")) for name, each in settings]
    return Table("Parameters as used", ("parameter", "value", "why"), rows, (0, 1, 2))


def components_table(report: Report) -> Table:
    """The components of an overset grid: each has a verdict of its own."""
    parts = report.get("components", ())
    heads = ("component", "blocks", "nodes", "moving", "largest displacement", "verdict", "steps", "f_skew min")
    rows = [
        (
            part["name"], len(part["blocks"]), part["nodes"], part["moving_nodes"], part["max_displacement"],
            component_verdict(part), part["steps"], part["quality"]["after"]["f_skew"]["min"],
        )
        for part in parts
    ]  # fmt: skip
    flagged = [n for n, part in enumerate(parts) if not part["valid"]]
    return Table(f"{len(rows)} components, each moved by its own boundary", heads, rows, (0, 5), flagged)


def component_verdict(part: Report) -> str:
    """Whether a component is valid, and how that was reached."""
    if part["reached"] < 1.0:
        return f"INVALID, {part['reached']:.1%} of the motion imposed"
    how = f"{part['steps']:,} step{'s' if part['steps'] != 1 else ''}{', repaired' if part['repair'] else ''}"
    bad = part["invalid_cells"]
    return f"valid, {how}" if part["valid"] else f"INVALID, {bad:,} cell{'s' if bad != 1 else ''}, {how}"


def levels_table(report: Report) -> Table:
    """The levels of a series."""
    heads = (
        "level", "time", "file", "moved", "rotated [deg]", "f_skew mean", "f_skew min", "invalid", "acceleration",
        "repaired", "steps", "seconds",
    )  # fmt: skip
    rows = []
    for level in report["levels"]:
        skew, acceleration = level["quality"]["f_skew"], acceleration_of(level)
        rows.append((
            f"{level['number']}", f"{level['time']:.6g}", level["file"],
            f"{level['max_displacement']:.4g}", f"{level['max_rotation_deg']:.2f}", f"{skew['mean']:.4f}",
            f"{skew['min']:.4f}", f"{level['quality']['invalid_cells']}",
            "" if acceleration is None else f"{acceleration:.3f}", repaired(level), f"{level['steps']}",
            f"{level['timing']['total']:.2f}",
        ))  # fmt: skip
    flagged = [n for n, level in enumerate(report["levels"]) if not level["valid"]]
    return Table("All levels", heads, rows, (2, 9), flagged)


def acceleration_of(level: Report) -> float | None:
    """The largest acceleration of a node in steps of the walls; ``None`` where earlier levels are missing."""
    found: float | None = (level.get("smoothness") or {}).get("acceleration")
    return found


def repaired(level: Report) -> str:
    """Whether nodes were moved by a repair: ``yes`` to its minimum, ``other`` elsewhere, ``no`` if it was left out."""
    repair = level.get("repair")
    if not repair:
        return ""
    if repair["left_out"]:
        return "no"
    return "yes" if repair["converged"] else "other"


def repair_lines(report: Report) -> list[str]:
    """How many cells were repaired, how far nodes moved, and measures of the method's grid beside those of the repaired
    one; empty without a repair, unless `meshdeform repair` found nothing to do."""
    done = report.get("repair")
    if not done:
        idle = report.get("new_interior", "") is None and report["valid"]
        return ["no cell is invalid or weak: nothing to repair"] if idle else []
    if done["left_out"]:
        return [f"not repaired: {done['left_out']}"]
    counts = [f"{done[kind]:,} {kind}" for kind in ("invalid", "weak") if done[kind]]
    cells = f"{' and '.join(counts) or 'no bad'} {'cell' if done['invalid'] + done['weak'] == 1 else 'cells'}"
    left = report.get("quality", {}).get("after", {}).get("invalid_cells", 0)
    what = f"not repaired: {counted(left, 'cell')} of {cells} stay invalid" if left else f"{cells} repaired"
    largest = report.get("boundary", {}).get("max_displacement")
    part = f" ({done['max_movement'] / largest:.2g} of the largest displacement)" if largest else ""
    moved = (
        f"{what}, {counted(done['nodes'], 'node')} moved by up to {done['max_movement']:.4g}{part}, "
        f"{counted(done['newton_steps'], 'Newton step')}"
    )
    found, before, after = [moved], done["before"], report.get("quality", {}).get("after")
    if before and after:
        both = [f"smallest scaled Jacobian {before['min_scaled_jacobian']:.3g} -> {after['min_scaled_jacobian']:.3g}"]
        both.append(f"smallest f_skew {before['f_skew']['min']:.3g} -> {after['f_skew']['min']:.3g}")
        key = "wall_normal_deviation_deg"
        if before[key] and after[key]:
            both.append(f"angle at walls {before[key]['rms']:.3g} -> {after[key]['rms']:.3g} degrees rms")
        if before["invalid_cells"]:
            both.append(f"invalid cells {before['invalid_cells']:,} -> {after['invalid_cells']:,}")
        found.append(f"the method alone -> repaired: {', '.join(both)}")
    found += [_WEAK] if done["weak"] else []
    return found


@dataclass(frozen=True)
class Figure:
    """A picture as PNG; ``caption`` describes it, also for readers who cannot see it."""

    title: str
    caption: str
    png: bytes


Illustrate = Callable[[], Sequence[Figure]]
"""Draws the pictures of a page."""
