"""The content of a blockMeshDict: vertices, blocks, curved edges and patches, checked entry by entry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Shape
from meshdeform_core.wording import vector

from .curves import Arc, Curve, Polygon, Spline, arc_about, arc_by_angle, arc_through, straight
from .dictionary import Atom, Dictionary, Item, Items
from .divisions import UNIFORM, Grading, Section, section_cells
from .entries import Reading, list_of, reading_of
from .patches import FoamPatch, read_patches
from .vertices import Vertices, read_vertices

_MOST_CELLS = 2**40
_GRADINGS = ("simpleGrading", "edgeGrading", "uniformGrading")
_EDGES = ("arc", "line", "polyLine", "spline", "BSpline")


@dataclass(frozen=True)
class HexBlock:
    """A block: its vertices (8,), cells along i, j, k, and the grading of its 12 edges."""

    name: str
    vertices: tuple[int, ...]
    cells: Shape
    gradings: tuple[Grading, ...]
    line: int


@dataclass(frozen=True)
class Layout:
    """The geometry from which blockMesh generates a mesh.

    Attributes
    ----------
    vertices : (n, 3) before scaling
    scale : (3,) factors of the coordinates
    curves : curved edges by their vertices (first, last)
    patches : with the default patch of all other outside faces
    """

    path: Path
    vertices: FloatArray
    scale: FloatArray
    blocks: tuple[HexBlock, ...]
    curves: dict[tuple[int, int], Curve]
    patches: tuple[FoamPatch, ...]


def read_layout(top: Dictionary) -> Layout:
    """The layout that a blockMeshDict describes.

    Raises
    ------
    FormatError
        With file and line, for what is missing, wrong, or not supported (projection, merged patches).
    """
    for key in ("vertices", "blocks"):
        if key not in top.entries:
            raise FormatError(f"{top.path} is an OpenFOAM dictionary without {key}; expected a blockMeshDict")
    _refuse(top)
    vertices = read_vertices(top)
    blocks = _blocks(top, vertices)
    corners = [(block.name, block.vertices) for block in blocks]
    curves, patches = _curves(top, vertices), read_patches(top, vertices, corners)
    return Layout(top.path, vertices.points, _scale(top), blocks, curves, patches)


def _refuse(top: Dictionary) -> None:
    reasons = {
        "mergePatchPairs": "it joins blocks whose nodes do not coincide; the grid is then not block-structured",
        "faces": "it projects faces onto surfaces of other files",
        "prescale": "only convertToMeters and scale change coordinates here",
        "transform": "only convertToMeters and scale change coordinates here",
    }
    for key, reason in reasons.items():
        value = top.entries.get(key)
        filled = isinstance(value, Dictionary) or any(not isinstance(v, Items) or v.values for v in value or ())
        if filled and not (isinstance(value, tuple) and _is_zero(value)):
            raise FormatError(f"{top.place(key)}: {key} is not supported: {reason}")


def _is_zero(value: tuple[Item, ...]) -> bool:
    """Whether it is an empty list preceded by its length, ``0 ()``."""
    return all(not v.values if isinstance(v, Items) else isinstance(v, Atom) and v.text == "0" for v in value)


def _scale(top: Dictionary) -> FloatArray:
    key = "scale" if "scale" in top.entries else "convertToMeters"
    found = reading_of(top, key)
    if not found.more:
        return np.ones(3)
    factor = found.next_number()
    scale = np.full(3, factor) if factor is not None else np.array(found.point("scale"))
    if not (scale > 0).all():
        raise FormatError(f"{top.place(key)}: {key} is {vector(scale)}; expected positive factors")
    return scale


def _blocks(top: Dictionary, vertices: Vertices) -> tuple[HexBlock, ...]:
    items = list_of(top, "blocks")
    found: list[HexBlock] = []
    while items.more:
        found.append(_block(items, vertices, len(found) + 1))
    if not found:
        items.fail("blocks is empty")
    names = [block.name for block in found]
    if len(set(names)) < len(names):
        items.fail(f"two blocks are called {next(n for n in names if names.count(n) > 1)!r}")
    return tuple(found)


def _block(items: Reading, known: Vertices, number: int) -> HexBlock:
    word, name, line = items.word("hex"), f"block{number}", items.line
    if word == "name":
        name, word = items.word("the name of a block"), items.word("hex")
    if word != "hex":
        items.fail(f"found {word!r}, expected hex; blocks of other shapes are hex with repeated vertices")
    corners = items.list("eight vertices")
    vertices = tuple(known.take(corners) for _ in range(8))
    if corners.more:
        corners.fail("a block has more than eight vertices")
    items.next_word()  # the cell zone
    cells = _cells(items)
    gradings = _gradings(items, cells)
    return HexBlock(name, vertices, cells, gradings, line)


def _cells(items: Reading) -> Shape:
    expected = "the numbers of cells, like (10 20 1)"
    first = items.next_number()
    counts = [first] if first is not None else []
    source = items if counts else items.list(expected)
    counts += [source.number(expected) for _ in range(3 - len(counts))]
    if source is not items and source.more:
        source.fail(f"more than three numbers of cells; expected {expected}")
    if any(n < 1 or n != int(n) for n in counts) or math.prod(counts) > _MOST_CELLS:
        items.fail(f"a block of {' x '.join(f'{n:g}' for n in counts)} cells; expected {expected}")
    i, j, k = (int(n) for n in counts)
    return i, j, k


def _gradings(items: Reading, cells: Shape) -> tuple[Grading, ...]:
    word = items.next_word()
    if word not in (None, *_GRADINGS):
        items.fail(f"found {word!r}, expected simpleGrading or edgeGrading")
    values, found = items.list("expansion ratios"), []
    while values.more:
        found.append(_grading(values))
    if len(found) not in (1, 3, 12):
        items.fail(f"{len(found)} expansion ratios; expected 1, 3 (along i, j, k) or 12 (one for each edge)")
    edges = found * 12 if len(found) == 1 else [found[n // 4] for n in range(12)] if len(found) == 3 else found
    for number, grading in enumerate(edges):
        count = cells[number // 4]
        if count >= len(grading) and section_cells(count, grading).min() < 1:
            items.fail(f"a section has no cells: {count} cells in parts {[p.cells for p in grading]}")
    return tuple(edges)


def _curves(top: Dictionary, vertices: Vertices) -> dict[tuple[int, int], Curve]:
    items, found = list_of(top, "edges"), dict[tuple[int, int], Curve]()
    while items.more:
        kind = items.word("the kind of an edge")
        if kind not in _EDGES:
            items.fail(f"edges of kind {kind!r} are not supported; known are {', '.join(_EDGES)}")
        first, last = vertices.take(items), vertices.take(items)
        curve = _curve(items, kind, vertices.points[first], vertices.points[last])
        # As in blockMesh, the first of several definitions counts.
        if (last, first) not in found:
            found.setdefault((first, last), curve)
    return found


def _curve(items: Reading, kind: str, first: FloatArray, last: FloatArray) -> Curve:
    if not (first != last).any():
        items.fail("both ends of the edge are at one point")
    if kind == "line":
        return straight(first, last)
    if kind == "arc":
        arc = _arc(items, first, last)
        if arc is None:
            items.fail("the points of the arc lie on one line")
        return arc
    points, values = [first], items.list("points (x y z)")
    while values.more:
        points.append(np.array(values.point("a point of the edge")))
    points.append(last)
    return Polygon(np.stack(points)) if kind == "polyLine" else Spline(np.stack(points), kind == "spline")


def _arc(items: Reading, first: FloatArray, last: FloatArray) -> Arc | None:
    """``(x y z)``, ``origin [factor] (x y z)`` or ``degrees (axis)``."""
    degrees = items.next_number()
    if degrees is not None:
        axis = np.array(items.point("the axis of an arc"))
        if not 0 < abs(degrees) < 360 or not axis.any():
            items.fail(f"an arc of {degrees:g} degrees about {vector(axis)}; expected 0 to 360 about a direction")
        return arc_by_angle(first, last, degrees, axis)
    word = items.next_word()
    if word == "origin":
        factor = items.next_number()
        return arc_about(first, last, np.array(items.point("the origin of an arc")), factor or 1.0)
    if word is not None:
        items.fail(f"found {word!r}, expected a point of the arc, origin, or an angle in degrees")
    return arc_through(first, np.array(items.point("a point of the arc")), last)


def _grading(values: Reading) -> Grading:
    """One ratio, or a list of sections ``(length cells ratio)``."""
    ratio = values.next_number()
    if ratio is not None:
        return (Section(ratio=_positive(values, ratio)),) if ratio != 1.0 else UNIFORM
    items, found = values.list("sections (length cells ratio)"), []
    while items.more:
        ratio = items.next_number()
        if ratio is not None:
            found.append(Section(ratio=_positive(items, ratio)))
            continue
        part = items.list("a section (length cells ratio)")
        length, cells = part.number("the length of a section"), part.number("the cells of a section")
        if length <= 0 or cells <= 0:
            part.fail(f"a section of length {length:g} with {cells:g} cells; expected positive shares")
        found.append(Section(length, cells, _positive(part, part.number("the expansion of a section"))))
    if not found:
        items.fail("a grading without sections")
    return tuple(found)


def _positive(items: Reading, ratio: float) -> float:
    """The expansion ratio; a negative value means the reciprocal of its magnitude."""
    if ratio == 0:
        items.fail("an expansion ratio of 0; expected the ratio of the last to the first cell")
    return -1.0 / ratio if ratio < 0 else ratio
