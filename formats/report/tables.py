"""What reports in several forms have in common: tables, sentences on repairs, pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from meshdeform_core.wording import counted

from .measures import change_of, measure_values, place_text
from .records import Report

ACCELERATION = "largest acceleration of a node, in the largest step of the walls; 2 where they turn back"
_LAYERS = (("first cell", "first_cell_height_ratio"), ("first cells together", "layer_thickness_ratio"))
_WEAK = "weak: sheared by more than 45 degrees, or twice or half as long in one direction"


@dataclass(frozen=True)
class Link:
    """A name with the file that it stands for."""

    name: str
    file: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Table:
    """Rows of texts, numbers (``None``: no value) and links.

    ``texts`` are numbers of columns of texts, all others hold numbers; ``flagged`` numbers of the rows to highlight;
    ``sortable``: by every column, where scripts run.
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Any]]
    texts: Sequence[int] = (0,)
    flagged: Sequence[int] = ()
    sortable: bool = False


def number(value: Any) -> str:
    """A formatted value: six digits, thousands separated; texts as they are, nothing for ``None``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "" if value is None else str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def is_alone(report: Report) -> bool:
    """Whether a grid was judged by itself: it has nothing to be compared with."""
    return "reference" in report and report["reference"] is None


def measures_table(report: Report, change: bool = False) -> Table:
    """All measures with the position of the worst cell."""
    alone, rows, flagged = is_alone(report), list[tuple[Any, ...]](), list[int]()
    for name, compared, before, after, place in measure_values(report["quality"]):
        if alone and compared:
            continue
        if name == "invalid cells" and after:
            flagged.append(len(rows))
        values = [after] if alone else [before, after, *([change_of(before, after)] if change else [])]
        rows.append((name, *values, place))
    heads = ("value",) if alone else ("before", "after", *(("change",) if change else ()))
    caption = "Quality measures; f_skew is Knupp's skew measure: 1 orthogonal, 0 invalid"
    return Table(caption, ("measure", *heads, "worst at"), rows, (0, len(heads) + 1), flagged)


def shape_table(report: Report) -> Table:
    """Measures that matter to flow solvers, with the position of the largest."""
    rows = []
    for name, after in report["shape"]["after"].items():
        before, place = (report["shape"]["before"] or {}).get(name), after.get("worst")
        shown = "wrong" if name == "face_pyramids" else "max"
        where = place_text(place) if place and after[shown] else ""
        rows.append((name, before[shown] if before else None, after[shown], after.get("mean"), where))
    heads = ("measure", "largest before", "largest", "mean", "largest at")
    return Table("Measures that matter to flow solvers", heads, rows, (0, 4))


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


def levels_table(report: Report, folder: str = "") -> Table:
    """The levels of a series, with links to their files in ``folder``."""
    heads = (
        "level", "time", "file", "moved", "rotated [deg]", "f_skew mean", "f_skew min", "invalid", "acceleration",
        "repaired", "steps", "seconds",
    )  # fmt: skip
    rows = []
    for level in report["levels"]:
        skew, acceleration = level["quality"]["f_skew"], acceleration_of(level)
        rows.append((
            f"{level['number']}", f"{level['time']:.6g}", Link(level["file"], level_link(folder, level["file"])),
            f"{level['max_displacement']:.4g}", f"{level['max_rotation_deg']:.2f}", f"{skew['mean']:.4f}",
            f"{skew['min']:.4f}", f"{level['quality']['invalid_cells']}",
            "" if acceleration is None else f"{acceleration:.3f}", repaired(level), f"{level['steps']}",
            f"{level['timing']['total']:.2f}",
        ))  # fmt: skip
    flagged = [n for n, level in enumerate(report["levels"]) if not level["valid"]]
    return Table("All levels", heads, rows, (2, 9), flagged, sortable=True)


def level_link(folder: str, name: str) -> str:
    """A file in ``folder`` as the address of a link."""
    return quote(PurePath(folder, name).as_posix())


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


def repair_sentence(report: Report) -> str:
    """All of :func:`repair_lines` in one sentence."""
    return "; ".join(repair_lines(report))


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
    found = [moved, *_compared(report), *([_WEAK] if done["weak"] else [])]
    changes = report.get("repaired_layers") or {}
    return [*found, *(_layer_text(name, change) for name, change in changes.items() if change)]


def _compared(report: Report) -> list[str]:
    """Measures of the method's grid and of the repaired one."""
    before, after = report["repair"]["before"], report.get("quality", {}).get("after")
    if not before or not after:
        return []
    found = [f"smallest scaled Jacobian {before['min_scaled_jacobian']:.3g} -> {after['min_scaled_jacobian']:.3g}"]
    found.append(f"smallest f_skew {before['f_skew']['min']:.3g} -> {after['f_skew']['min']:.3g}")
    key = "wall_normal_deviation_deg"
    if before[key] and after[key]:
        found.append(f"angle at walls {before[key]['rms']:.3g} -> {after[key]['rms']:.3g} degrees rms")
    if before["invalid_cells"]:
        found.append(f"invalid cells {before['invalid_cells']:,} -> {after['invalid_cells']:,}")
    return [f"the method alone -> repaired: {', '.join(found)}"]


def _layer_text(name: str, change: Report) -> str:
    walls = f"of the {change['lines']:,} grid lines that begin at {name} walls"
    if not change["changed"]:
        return f"none {walls} changed by more than 1% in its first cells"
    ranges = [(what, change[key]) for what, key in _LAYERS if change[key]]
    heights = ", ".join(f"{what} {ratio['min']:.3g}..{ratio['max']:.3g}" for what, ratio in ranges)
    return (
        f"{change['changed']:,} {walls} changed by more than 1% there (height over that by the method alone: {heights})"
    )


@dataclass(frozen=True)
class Figure:
    """A picture, or the same view before and after (both PNG, of one size).

    ``names`` label the two; ``caption`` describes the picture, also for readers who cannot see it. Only a pair in the
    same window can have a ``slider``; others are shown side by side.
    """

    title: str
    caption: str
    after: bytes
    before: bytes | None = None
    slider: bool = True
    names: tuple[str, str] = ("before", "after")


@dataclass(frozen=True)
class Illustrations:
    """Pictures of one deformation, and thumbnails of the levels of a series with the files that they link to."""

    figures: tuple[Figure, ...] = ()
    thumbnails: tuple[tuple[Figure, str], ...] = ()


Illustrate = Callable[[], Illustrations]
