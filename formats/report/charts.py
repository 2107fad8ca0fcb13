"""Charts as inline SVG whose colours follow the page."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..picture import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours of the page's style sheet, which stand for these in the drawing.
_INK, _LINE, _BEFORE, _AFTER, _BAD = "#010101", "#020202", "#030303", "#040404", "#050505"
_OF_PAGE = {
    _INK: "currentColor", _LINE: "var(--line)", _BEFORE: "var(--before)", _AFTER: "var(--after)", _BAD: "var(--bad)",
}  # fmt: skip
_LEAST = 0.3


def histogram(before: Sequence[int] | None, after: Sequence[int], label: str) -> str:
    """Cells per bin of [0, 1] on a logarithmic scale, which shows a few bad cells among millions of good ones."""
    figure, axes = _axes()
    width = 1 / len(after)
    sets = (
        [(after, _AFTER, 0.5, 0.72)] if before is None else [(before, _BEFORE, 0.29, 0.41), (after, _AFTER, 0.71, 0.41)]
    )
    for counts, colour, middle, thick in sets:
        there = [n for n, count in enumerate(counts) if count]
        # Half a decade below 1, so that a single cell has a visible bar.
        heights = [counts[n] - _LEAST for n in there]
        places = [(n + middle) * width for n in there]
        axes.bar(places, heights, thick * width, bottom=_LEAST, color=colour)
    axes.set(yscale="log", xlim=(0, 1), xlabel=label, ylabel="cells")
    axes.set_ylim(bottom=_LEAST, top=max(10.0, *after, *(before or ())) * 1.3)
    return _svg(figure, f"cells over {label}")


def curve(x: Sequence[float], y: Sequence[float], x_label: str, y_label: str, wrong: Sequence[bool]) -> str:
    """One quantity over another, one dot per point; ``wrong`` marks points in the colour of errors."""
    figure, axes = _axes()
    axes.plot(x, y, color=_AFTER, linewidth=1.5)
    if len(x) <= 60:
        axes.plot(x, y, "o", color=_AFTER, markersize=4)
    bad = [n for n, each in enumerate(wrong) if each]
    axes.plot([x[n] for n in bad], [y[n] for n in bad], "o", color=_BAD, markersize=5)
    axes.set(xlabel=x_label, ylabel=y_label)
    return _svg(figure, f"{y_label} over {x_label}")


def _axes() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 2.8), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(axis="y", color=_LINE)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _svg(figure: Figure, label: str) -> str:
    """The drawing as an element of the page."""
    import matplotlib as mpl

    (axes,), buffer = figure.axes, io.BytesIO()
    axes.tick_params(colors=_INK, which="both")
    for each in (axes.xaxis.label, axes.yaxis.label):
        each.set_color(_INK)
    for spine in axes.spines.values():
        spine.set_color(_INK)
    with mpl.rc_context(STYLE):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    text = buffer.getvalue().decode()
    # Several drawings on a page have no use for the names of groups, and none of them is clipped.
    text = re.sub(r' (clip-path|xmlns(:\w+)?)="[^"]*"|(?<=<g) id="[^"]*"', "", text[text.index("<svg") :])
    for colour, name in _OF_PAGE.items():
        text = text.replace(colour, name)
    return text.replace("<svg", f'<svg class="chart" role="img" aria-label="{label}"', 1)
