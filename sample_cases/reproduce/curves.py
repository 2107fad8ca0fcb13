"""Figures of the robustness curves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from meshdeform_formats.picture.page import STYLE

from .figures import save_small

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c564b", "#7f7f7f")
_MARKERS = "osD^vP*Xh"


def draw_curves(parts: dict[str, Any], folder: Path) -> list[str]:
    """Write all figures; returns their names."""
    drawers: dict[str, Callable[[Any, dict[str, Any]], None]] = {
        "robustness-angle": _angles,
        "robustness-quality": _quality,
        "robustness-sub-blocks": _sub_blocks,
        "robustness-alpha": _alpha,
    }
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = []
    for name, drawer in drawers.items():
        with plt.rc_context(STYLE):
            figure = plt.figure(figsize=(6.8, 3.2), layout="constrained")
            drawer(figure, parts)
            names.append(f"{name}.png")
            save_small(figure, folder / names[-1], 130)
            plt.close(figure)
    return names


def _angles(figure: Any, parts: dict[str, Any]) -> None:
    axes = figure.subplots()
    rows = parts["largest_angle"]["rows"]
    at = range(len(rows))
    bars = {"one_step": "one step", "marching": "marching, 5° steps", "repaired": "one step and repair"}
    for place, (key, label) in enumerate(bars.items()):
        width = [r[key] or 0.0 for r in rows]
        axes.barh([i + 0.27 * (place - 1) for i in at], width, 0.25, color=_COLOURS[place], label=label)
    axes.set_yticks(list(at), [r["method"] for r in rows])
    axes.invert_yaxis()
    axes.set_xlabel("largest valid rotation [deg]")
    axes.set_xlim(0, 5 + max(r[key] or 0.0 for r in rows for key in bars))
    axes.grid(axis="x", linewidth=0.3)
    figure.legend(loc="outside upper right", ncols=3, frameon=False)


def _quality(figure: Any, parts: dict[str, Any]) -> None:
    left, right = figure.subplots(1, 2)
    for curve, colour, marker in zip(parts["quality"], _COLOURS, _MARKERS, strict=False):
        points = [p for p in curve["points"] if p["invalid_cells"] == 0]
        style = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.0}
        angle = [p["angle"] for p in points]
        left.plot(angle, [p["f_skew_min"] for p in points], **style, label=curve["method"])
        right.plot(angle, [p["wall_deviation_rms_deg"] for p in points], **style)
    _axes(left, "rotation [deg]", "minimum of $f_{skew}$", (0, 1))
    _axes(right, "rotation [deg]", "wall-normal deviation rms [deg]", None)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)


def _sub_blocks(figure: Any, parts: dict[str, Any]) -> None:
    left, right = figure.subplots(1, 2)
    cut = [p for p in parts["sub_blocks"] if p["max_cells"]]
    limits = [p for p in parts["sub_blocks"] if not p["max_cells"]]
    names = {0: "IDW-TFI, no sub-blocks", None: "IDW-IDW"}
    for axes, key in ((left, "f_skew_min"), (right, "wall_deviation_rms_deg")):
        axes.plot([p["max_cells"] for p in cut], [p[key] for p in cut], "o-", color=_COLOURS[0], markersize=4)
        for limit, style in zip(limits, ("--", ":"), strict=True):
            axes.axhline(limit[key], linestyle=style, color="black", linewidth=0.9, label=names[limit["max_cells"]])
        axes.set_xscale("log", base=2)
        ticks = [p["max_cells"] for p in cut]
        axes.set_xticks(ticks, [str(t) for t in ticks])
        axes.minorticks_off()
    _axes(left, "cells per sub-block and direction", "minimum of $f_{skew}$", None)
    _axes(right, "cells per sub-block and direction", "wall-normal deviation rms [deg]", None)
    left.legend(frameon=False)


def _alpha(figure: Any, parts: dict[str, Any]) -> None:
    left, right = figure.subplots(1, 2)
    angles = sorted({p["angle"] for p in parts["alpha"]})
    for angle, colour, marker in zip(angles, _COLOURS, _MARKERS, strict=False):
        points = [p for p in parts["alpha"] if p["angle"] == angle]
        style = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.0}
        valid = [p for p in points if p["invalid_cells"] == 0]
        left.plot([p["alpha"] for p in points], [p["f_skew_min"] for p in points], **style, label=f"{angle:g}°")
        right.plot([p["alpha"] for p in valid], [p["wall_deviation_rms_deg"] for p in valid], **style)
    ticks = sorted({p["alpha"] for p in parts["alpha"]})
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlim(ticks[0] / 1.2, ticks[-1] * 1.2)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    _axes(left, r"$\alpha$", "minimum of $f_{skew}$ (0: crossed cells)", (-0.02, 1))
    _axes(right, r"$\alpha$", "wall-normal deviation rms [deg]", None)
    left.legend(frameon=False, title="rotation")


def _axes(axes: Any, x: str, y: str, limits: tuple[float, float] | None) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(linewidth=0.3)
    if limits:
        axes.set_ylim(*limits)
