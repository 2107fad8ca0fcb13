"""Charts as inline SVG whose colours follow the page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

# For viewers that ignore style sheets in SVG, which fill the area under a curve.
_OUTLINE = 'fill="none" stroke="currentColor"'
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 640, 280, 62, 12, 12, 44


def histogram(before: Sequence[int] | None, after: Sequence[int], label: str) -> str:
    """Cells per bin of [0, 1] on a logarithmic scale, which shows a few bad cells among millions of good ones."""
    decades = max(1, math.ceil(math.log10(max(*(before or [1]), *after, 2))))
    return _svg(label, [*_histogram_axes(decades, label), *_bars(before, after, decades)])


def _bars(before: Sequence[int] | None, after: Sequence[int], decades: int) -> Iterator[str]:
    width = (_WIDTH - _LEFT - _RIGHT) / len(after)
    sets = [("before", before, 0.08), ("after", after, 0.51)] if before else [("after", after, 0.14)]
    thick = 0.41 if before else 0.72
    for n in range(len(after)):
        for name, counts, shift in sets:
            if counts and counts[n]:
                top = _decade_height(counts[n], decades)
                low, high = n / len(after), (n + 1) / len(after)
                yield (
                    f'<rect class="{name}" x="{_LEFT + (n + shift) * width:.1f}" y="{top:.1f}" '
                    f'width="{thick * width:.1f}" height="{_HEIGHT - _BOTTOM - top:.1f}">'
                    f"<title>{name}: {counts[n]:,} cells from {low:.2f} to {high:.2f}</title></rect>"
                )


def _decade_height(count: float, decades: int) -> float:
    """Height of a decade; half a decade below 1 is included so that a single cell has a visible bar."""
    share = (math.log10(count) + 0.5) / (decades + 0.5)
    return _TOP + (_HEIGHT - _TOP - _BOTTOM) * (1.0 - share)


def _histogram_axes(decades: int, label: str) -> Iterator[str]:
    for power in range(decades + 1):
        y = _decade_height(10**power, decades)
        text = f"{10**power:,}" if power < 7 else f"1e{power}"
        yield f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        yield f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
    for tenth in range(0, 11, 2):
        x = _LEFT + (_WIDTH - _LEFT - _RIGHT) * tenth / 10
        yield f'<text x="{x:.1f}" y="{_HEIGHT - _BOTTOM + 17}" text-anchor="middle">{tenth / 10:.1f}</text>'
    yield from _frame(label, "cells")


def curve(x: Sequence[float], y: Sequence[float], x_label: str, y_label: str, wrong: Sequence[bool] = ()) -> str:
    """One quantity over another, one dot per point; ``wrong`` marks points in the colour of errors."""
    xs, ys = ticks(min(x), max(x)), ticks(min(y), max(y))
    parts = list(_curve_axes(xs, ys, x_label, y_label))
    at = [(_across(a, xs), _up(b, ys)) for a, b in zip(x, y, strict=True)]
    parts.append(f'<path class="line" {_OUTLINE} d="M{" L".join(f"{a:.1f} {b:.1f}" for a, b in at)}"/>')
    for n, (a, b) in enumerate(at):
        kind = "dot wrong" if n < len(wrong) and wrong[n] else "dot"
        if len(at) <= 60 or kind != "dot":
            parts.append(
                f'<circle class="{kind}" cx="{a:.1f}" cy="{b:.1f}" r="3.5"><title>{x[n]:g}: {y[n]:.6g}</title></circle>'
            )
    return _svg(f"{y_label} over {x_label}", parts)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers that enclose low..high."""
    span = high - low or abs(high) or 1.0
    rough = span / count
    size = 10.0 ** math.floor(math.log10(rough))
    step = next(size * m for m in (1, 2, 2.5, 5, 10) if size * m >= rough * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [n * step for n in range(first, max(last, first + 1) + 1)]


def labels(values: Sequence[float]) -> list[str]:
    """Distinct labels of ticks, with as many digits as necessary, or as differences from the first one."""
    for digits in range(4, 9):
        texts = [f"{value:.{digits}g}" for value in values]
        if len(set(texts)) == len(values) and all(
            abs(float(text) - value) <= 1e-3 * abs(values[-1] - values[0])
            for text, value in zip(texts, values, strict=True)
        ):
            return texts
    return [f"{values[0]:.6g}", *(f"+{value - values[0]:.3g}" for value in values[1:])]


def _across(value: float, scale: Sequence[float]) -> float:
    return _LEFT + (_WIDTH - _LEFT - _RIGHT) * (value - scale[0]) / (scale[-1] - scale[0])


def _up(value: float, scale: Sequence[float]) -> float:
    return _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * (value - scale[0]) / (scale[-1] - scale[0])


def _curve_axes(xs: Sequence[float], ys: Sequence[float], x_label: str, y_label: str) -> Iterator[str]:
    for value, text in zip(ys, labels(ys), strict=True):
        y = _up(value, ys)
        yield f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        yield f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
    for value, text in zip(xs, labels(xs), strict=True):
        yield f'<text x="{_across(value, xs):.1f}" y="{_HEIGHT - _BOTTOM + 17}" text-anchor="middle">{text}</text>'
    yield from _frame(x_label, y_label)


def _frame(x_label: str, y_label: str) -> Iterator[str]:
    middle = (_HEIGHT - _BOTTOM + _TOP) / 2
    yield f'<path class="axis" {_OUTLINE} d="M{_LEFT} {_TOP} V{_HEIGHT - _BOTTOM} H{_WIDTH - _RIGHT}"/>'
    yield f'<text x="{(_LEFT + _WIDTH) / 2:.0f}" y="{_HEIGHT - 6}" text-anchor="middle">{x_label}</text>'
    yield f'<text transform="translate(12 {middle:.0f}) rotate(-90)" text-anchor="middle">{y_label}</text>'


def _svg(label: str, parts: Sequence[str]) -> str:
    return f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
