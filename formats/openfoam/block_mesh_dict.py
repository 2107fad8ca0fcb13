"""The content of a blockMeshDict: vertices, blocks, curved edges and patches, checked entry by entry.

Edges are divided and curved as by blockMesh: arcs are uniform in angle; lines through points and splines in the length
of the polygon through the points.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError, suggestion
from meshdeform_core.grid import FloatArray, IntArray, Shape, Side
from meshdeform_core.wording import vector

from .dictionary import Dictionary, Reading

_MOST_CELLS = 2**40
_GRADINGS = ("simpleGrading", "edgeGrading", "uniformGrading")
_CURVES = ("arc", "line", "polyLine", "spline", "BSpline")
# Local vertices of the block sides, in the order of Side, which is that of blockMesh.
SIDE_VERTICES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
_UNSUPPORTED = {
    "mergePatchPairs": "it joins blocks whose nodes do not coincide; the grid is then not block-structured",
    "faces": "it projects faces onto surfaces of other files",
    "prescale": "only convertToMeters and scale change coordinates here",
    "transform": "only convertToMeters and scale change coordinates here",
}

_END = 1e-15
"""OpenFOAM's SMALL: parameters closer to an end of the curve are that end."""

Curve = Callable[[FloatArray], FloatArray]
"""Positions (n, 3) for parameters (n,) from 0 to 1."""


@dataclass(frozen=True)
class Section:
    """Part of an edge: its share of the length and of the cells, and the ratio of its last to its first cell."""

    length: float = 1.0
    cells: float = 1.0
    ratio: float = 1.0


Grading = tuple[Section, ...]
BlockSide = tuple[int, Side]


@dataclass(frozen=True)
class HexBlock:
    """A block: its vertices (8,), cell zone, cells along i, j, k, and the grading of its 12 edges."""

    name: str
    vertices: tuple[int, ...]
    zone: str
    cells: Shape
    gradings: tuple[Grading, ...]
    line: int


@dataclass(frozen=True)
class FoamPatch:
    """A patch: its block sides, and its entries other than faces."""

    name: str
    type: str
    sides: tuple[BlockSide, ...]
    content: Dictionary


@dataclass(frozen=True)
class BlockMeshDict:
    """The geometry from which blockMesh generates a mesh.

    Attributes
    ----------
    vertices : (n, 3) before scaling
    scale : (3,) factors of the coordinates
    curves : curved edges by their vertices (first, last)
    patches : with the default patch of all other outside faces
    joined : pairs of blocks with a common side: the same vertices, wherever these lie
    """

    path: Path
    vertices: FloatArray
    scale: FloatArray
    blocks: tuple[HexBlock, ...]
    curves: dict[tuple[int, int], Curve]
    patches: tuple[FoamPatch, ...]
    joined: tuple[tuple[int, int], ...]


def read_block_mesh_dict(top: Dictionary) -> BlockMeshDict:
    """What a blockMeshDict describes."""
    for key in ("vertices", "blocks"):
        if key not in top.entries:
            raise FormatError(f"{top.path} is an OpenFOAM dictionary without {key}; expected a blockMeshDict")
    for key, reason in _UNSUPPORTED.items():
        entry = top.reading(key)
        entry.next_number()
        # An empty list may be preceded by its length.
        if entry.more and (isinstance(top.entries[key], Dictionary) or entry.list(key).more or entry.more):
            raise FormatError(f"{top.place(key)}: {key} is not supported: {reason}")
    known = _Vertices(top)
    items, found = top.list("blocks"), list[HexBlock]()
    while items.more:
        found.append(_block(items, known, len(found) + 1))
    if not found:
        items.fail("blocks is empty")
    names = [block.name for block in found]
    if len(set(names)) < len(names):
        items.fail(f"two blocks are called {next(n for n in names if names.count(n) > 1)!r}")
    blocks = tuple(found)
    sides: dict[tuple[int, ...], list[BlockSide]] = {}
    for number, block in enumerate(blocks):
        for side in Side:
            sides.setdefault(_side_key(block, side), []).append((number, side))
    joined = tuple((two[0][0], two[1][0]) for key, two in sides.items() if len(two) == 2 < len(key))
    items, curves = top.list("edges"), dict[tuple[int, int], Curve]()
    while items.more:
        kind = items.word("the kind of an edge")
        if kind not in _CURVES:
            items.fail(f"edges of kind {kind!r} are not supported; known are {', '.join(_CURVES)}")
        first, last = known.take(items), known.take(items)
        curve = _curve(items, kind, known.points[first], known.points[last])
        # As in blockMesh, the first of several definitions counts.
        if (last, first) not in curves:
            curves.setdefault((first, last), curve)
    patches = _read_patches(top, known, blocks, sides)
    key, scale = "scale" if "scale" in top.entries else "convertToMeters", np.ones(3)
    factors = top.reading(key)
    if factors.more:
        factor = factors.next_number()
        scale = np.full(3, factor) if factor is not None else np.array(factors.point("scale"))
    if not (scale > 0).all():
        raise FormatError(f"{top.place(key)}: {key} is {vector(scale)}; expected positive factors")
    return BlockMeshDict(top.path, known.points, scale, blocks, curves, patches, joined)


class _Vertices:
    """Points (n, 3) before scaling, and the numbers of those that have names; projected vertices are refused."""

    def __init__(self, top: Dictionary):
        items = top.list("vertices")
        points: list[tuple[float, float, float]] = []
        self.names: dict[str, int] = {}
        while items.more:
            word = items.next_word()
            if word == "name":
                self.names[items.word("the name of a vertex")] = len(points)
                word = items.next_word()
            if word is not None:
                items.fail(f"{word} is not supported in vertices; expected points (x y z)")
            points.append(items.point("a vertex"))
        self.points: FloatArray = np.array(points, dtype=np.float64).reshape(-1, 3)

    def take(self, items: Reading) -> int:
        """Take the next vertex; returns its number."""
        word = items.next_word()
        number = items.whole("the number of a vertex") if word is None else self.names.get(word, -1)
        if not 0 <= number < len(self.points):
            hint = suggestion(word, self.names) if word else f"; the file has 0 to {len(self.points) - 1}"
            items.fail(f"there is no vertex {word or number!r}{hint}")
        return number


def _block(items: Reading, known: _Vertices, number: int) -> HexBlock:
    word, name, line = items.word("hex"), f"block{number}", items.line
    if word == "name":
        name, word = items.word("the name of a block"), items.word("hex")
    if word != "hex":
        items.fail(f"found {word!r}, expected hex; blocks of other shapes are hex with repeated vertices")
    corners = items.list("eight vertices")
    vertices = [known.take(corners) for _ in range(8)]
    # Like blockMesh, which wants these to exist, too.
    while corners.more:
        known.take(corners)
    zone = items.next_word() or ""
    expected = "the numbers of cells, like (10 20 1)"
    first = items.next_number()
    source = items if first is not None else items.list(expected)
    counts = [] if first is None else [first]
    counts += [source.number(expected) for _ in range(3 - len(counts))]
    if source is not items and source.more:
        source.fail(f"more than three numbers of cells; expected {expected}")
    if any(n < 1 or n != int(n) for n in counts) or math.prod(counts) > _MOST_CELLS:
        items.fail(f"a block of {' x '.join(f'{n:g}' for n in counts)} cells; expected {expected}")
    cells = (int(counts[0]), int(counts[1]), int(counts[2]))
    kind = items.next_word()
    if kind not in (None, *_GRADINGS):
        items.fail(f"found {kind!r}, expected simpleGrading or edgeGrading")
    values, found = items.list("expansion ratios"), []
    while values.more:
        found.append(_grading(values))
    if len(found) not in (1, 3, 12):
        items.fail(f"{len(found)} expansion ratios; expected 1, 3 (along i, j, k) or 12 (one for each edge)")
    edges = tuple(found[edge * len(found) // 12] for edge in range(12))
    for edge, grading in enumerate(edges):
        count = cells[edge // 4]
        if count >= len(grading) and section_cells(count, grading).min() < 1:
            items.fail(f"a section has no cells: {count} cells in parts {[p.cells for p in grading]}")
    return HexBlock(name, tuple(vertices), zone, cells, edges, line)


def _grading(values: Reading) -> Grading:
    """One ratio, or a list of sections ``(length cells ratio)``."""
    ratio = values.next_number()
    if ratio is not None:
        return (Section(ratio=_positive_ratio(values, ratio)),)
    items, found = values.list("sections (length cells ratio)"), []
    while items.more:
        ratio = items.next_number()
        if ratio is not None:
            found.append(Section(ratio=_positive_ratio(items, ratio)))
            continue
        part = items.list("a section (length cells ratio)")
        length, cells = part.number("the length of a section"), part.number("the cells of a section")
        if length <= 0 or cells <= 0:
            part.fail(f"a section of length {length:g} with {cells:g} cells; expected positive shares")
        found.append(Section(length, cells, _positive_ratio(part, part.number("the expansion of a section"))))
    if not found:
        items.fail("a grading without sections")
    return tuple(found)


def _positive_ratio(items: Reading, ratio: float) -> float:
    """The expansion ratio; a negative value means the reciprocal of its magnitude."""
    if ratio == 0:
        items.fail("an expansion ratio of 0; expected the ratio of the last to the first cell")
    return -1.0 / ratio if ratio < 0 else ratio


def _curve(items: Reading, kind: str, first: FloatArray, last: FloatArray) -> Curve:
    if not (first != last).any():
        items.fail("both ends of the edge are at one point")
    if kind == "line":
        return straight(first, last)
    if kind == "arc":
        # (x y z), origin [factor] (x y z) or degrees (axis).
        degrees = items.next_number()
        if degrees is not None:
            axis = np.array(items.point("the axis of an arc"))
            if not 0 < abs(degrees) < 360 or not axis.any():
                items.fail(f"an arc of {degrees:g} degrees about {vector(axis)}; expected 0 to 360 about a direction")
            arc = arc_by_angle(first, last, math.radians(degrees), axis)
        elif (word := items.next_word()) == "origin":
            factor = items.next_number()
            arc = arc_about(first, last, np.array(items.point("the origin of an arc")), factor or 1.0)
        elif word is not None:
            items.fail(f"found {word!r}, expected a point of the arc, origin, or an angle in degrees")
        else:
            arc = arc_through(first, np.array(items.point("a point of the arc")), last)
        if arc is None:
            items.fail("the points of the arc lie on one line")
        return arc
    points, values = [first], items.list("points (x y z)")
    while values.more:
        points.append(np.array(values.point("a point of the edge")))
    return spline(np.stack([*points, last]), kind)


def _read_patches(
    top: Dictionary, vertices: _Vertices, blocks: Sequence[HexBlock], sides: Mapping[tuple[int, ...], list[BlockSide]]
) -> tuple[FoamPatch, ...]:
    """The patches of ``boundary`` (or ``patches``, the form before OpenFOAM 2), and the default patch of all outside
    faces that none of them has; ``sides`` are the block sides by their vertices."""
    old, found, owners = "boundary" not in top.entries, list[FoamPatch](), dict[BlockSide, str]()
    items = top.list("patches" if old else "boundary")
    while items.more:
        kind = items.word("the type of a patch") if old else ""
        name = items.word("the name of a patch")
        content = Dictionary(top.path, items.line) if old else items.dictionary(f"patch {name}")
        for key in () if old else ("type", "faces"):
            if key not in content.entries:
                raise FormatError(f"{top.path}, line {content.line}: the patch {name!r} has no {key}; expected one")
        if name in (patch.name for patch in found):
            items.fail(f"two patches are called {name!r}")
        faces = items.list("faces") if old else content.list("faces")
        own = list[BlockSide]()
        for block, side in _sides_of_faces(faces, name, vertices, blocks, sides):
            collapsed = len(_side_key(blocks[block], side)) < 3
            if (block, side) in owners and not collapsed:
                both = f"{owners[block, side]} and {name}"
                faces.fail(f"{blocks[block].name}.{side.label} belongs to the patches {both}; expected one")
            owners[block, side] = name
            own += [] if collapsed else [(block, side)]
        found.append(FoamPatch(name, kind or content.text("type"), tuple(own), content))
    rest = {own[0]: key for key, own in sides.items() if len(own) == 1 and own[0] not in owners}
    if not rest:
        return tuple(found)
    default = top.entries.get("defaultPatch", Dictionary(top.path, 1))
    content = default if isinstance(default, Dictionary) else Dictionary(top.path, 1)
    # As in blockMesh, it is there, without faces, where only sides that are collapsed to lines are in no patch.
    faces_of_rest = tuple(place for place, key in rest.items() if len(key) > 2)
    patch = FoamPatch(content.text("name", "defaultFaces"), content.text("type", "empty"), faces_of_rest, content)
    for declared in [other for other in found if other.name == patch.name]:
        if declared.sides:
            raise FormatError(f"{top.path}: the default patch has the name of another patch, {patch.name!r}")
        found.remove(declared)
        patch = dataclasses.replace(declared, sides=patch.sides)
    return (*found, patch)


def _sides_of_faces(
    items: Reading, name: str, vertices: _Vertices, blocks: Sequence[HexBlock],
    sides: Mapping[tuple[int, ...], list[BlockSide]],
) -> Iterator[BlockSide]:  # fmt: skip
    """The block sides of the faces of a patch, which are outside or collapsed to lines."""
    while items.more:
        face = items.list(f"a face of patch {name}")
        # Two numbers are a block and its side, others are vertices.
        pair, numbers = len(face) == 2, list[int]()
        while face.more:
            numbers.append(face.whole("a block and a side") if pair else vertices.take(face))
        key = tuple(sorted(set(numbers)))
        if pair and 0 <= numbers[0] < len(blocks) and 0 <= numbers[1] < 6:
            key = _side_key(blocks[numbers[0]], Side(numbers[1]))
        own = sides.get(key, []) if len(numbers) < 5 else []
        if not own or (len(own) > 1 and len(key) > 2):
            wrong = "lies between two blocks; expected an outside face" if own else "is not a side of any block"
            items.fail(f"patch {name}: the face ({' '.join(map(str, numbers))}) {wrong}")
        yield from own


def _side_key(block: HexBlock, side: Side) -> tuple[int, ...]:
    """The vertices of a block side, ascending without repetition."""
    return tuple(sorted({block.vertices[v] for v in SIDE_VERTICES[side]}))


# --- edges


def divide(cells: int, grading: Sequence[Section]) -> FloatArray:
    """Parameters (cells + 1,) of the nodes from 0 to 1, as blockMesh places them.

    An edge with fewer cells than sections is divided uniformly. The section with the largest share of cells absorbs
    the rounding.
    """
    if cells < len(grading):
        return np.linspace(0.0, 1.0, cells + 1)
    lengths = np.array([part.length for part in grading])
    found = [np.zeros(1)]
    for part, length, count in zip(grading, lengths / lengths.sum(), section_cells(cells, grading), strict=True):
        steps = np.arange(1, count + 1)
        if count < 2 or abs(part.ratio - 1.0) < 1e-12:
            own = steps / max(count, 1)
        else:
            growth = part.ratio ** (1.0 / (count - 1))
            own = (1.0 - growth**steps) / (1.0 - growth**count)
        found.append(found[-1][-1] + length * own)
    nodes = np.concatenate(found)
    nodes[-1] = 1.0
    return nodes


def section_cells(cells: int, grading: Sequence[Section]) -> IntArray:
    """Cells of each section of an edge that has at least as many cells as sections."""
    shares = np.array([part.cells for part in grading])
    shares = shares / shares.sum()
    counts = np.floor(shares * cells + 0.5).astype(np.int64)
    counts[np.argmax(shares)] += cells - counts.sum()
    return np.asarray(counts)


def arc_through(first: FloatArray, middle: FloatArray, last: FloatArray) -> Curve | None:
    """The arc through three points; ``None`` if they lie on one line."""
    a, b = middle - first, last - middle
    axis = np.cross(a, b)
    if np.linalg.norm(axis) <= 1e-10 * np.linalg.norm(a) * np.linalg.norm(b):
        return None
    # The angle at a point of a circle is half of that of the arc which it sees.
    angle = 2.0 * _angle(a, b)
    if min(angle, 2.0 * _angle(b, last - first)) > math.pi:
        # Like blockMesh, which takes the shorter way where the middle point is more than half a turn away.
        angle, axis = 2.0 * math.pi - angle, -axis
    return arc_by_angle(first, last, angle, axis)


def arc_about(first: FloatArray, last: FloatArray, origin: FloatArray, stretch: float = 1.0) -> Curve | None:
    """The shorter arc about ``origin``, which is moved if the ends are not equally far from it.

    ``stretch`` times the mean radius is the radius. ``None`` if origin and ends lie on one line.
    """
    r1, r3, half = first - origin, last - origin, 0.5 * float(np.linalg.norm(last - first))
    m1, m3 = float(np.linalg.norm(r1)), float(np.linalg.norm(r3))
    axis, angle = np.cross(r1, r3), _angle(r1, r3)
    if np.linalg.norm(axis) <= 1e-10 * m1 * m3:
        return None
    if abs(m1 - m3) > _END * max(m1, m3) or stretch != 1.0:
        radius = 0.5 * (m1 + m3) if stretch == 1.0 else max(0.5 * (m1 + m3) * stretch, 1.001 * half)
        angle = 2.0 * math.atan2(half, math.sqrt(max(radius**2 - half**2, 0.0)))
    return arc_by_angle(first, last, angle, axis)


def arc_by_angle(first: FloatArray, last: FloatArray, angle: float, axis: FloatArray) -> Curve | None:
    """The arc of ``angle`` radians about the direction ``axis``, or the helix, if it also advances along it; ``None``
    if the ends do not lie across it."""
    axis = axis / np.linalg.norm(axis)
    step = last - first
    chord = step - (step @ axis) * axis
    length = float(np.linalg.norm(chord))
    if length <= 1e-10 * float(np.linalg.norm(step)):
        return None
    # From the centre to the first point, and a quarter of a turn further.
    out = np.cross(chord, axis) * (0.5 / math.tan(0.5 * angle)) - 0.5 * chord
    further = np.cross(axis, out)

    def place(parameter: FloatArray) -> FloatArray:
        at = parameter[:, None]
        found = first - out + at * (step @ axis) * axis + np.cos(at * angle) * out + np.sin(at * angle) * further
        return _with_ends(found, parameter, first, last)

    return place


def straight(first: FloatArray, last: FloatArray) -> Curve:
    """The straight line between two points, which may be the same."""
    return lambda parameter: _with_ends(first + parameter[:, None] * (last - first), parameter, first, last)


_BASES = {
    "polyLine": np.array([[0, 1, 0, 0], [0, -1, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], dtype=float),
    # Catmull-Rom, through all points, and the uniform B-spline, through the ends only.
    "spline": 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]], dtype=float),
    "BSpline": np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=float) / 6.0,
}


def spline(points: FloatArray, kind: str) -> Curve:
    """Piecewise polynomial by points (n, 3), of a kind of edge of a blockMeshDict: polyLine, spline or BSpline."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    lengths /= lengths[-1]
    padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])

    def place(parameter: FloatArray) -> FloatArray:
        segment = np.clip(np.searchsorted(lengths, parameter, side="left") - 1, 0, len(points) - 2)
        width = lengths[segment + 1] - lengths[segment]
        local = (parameter - lengths[segment]) / np.where(width > 0, width, 1.0)
        weights = (local[:, None] ** np.arange(4)) @ _BASES[kind]
        found = sum(weights[:, n, None] * padded[segment + n] for n in range(4))
        # blockMesh takes the points themselves at both ends of a segment, also where the B-spline misses them.
        found = np.where((local <= 0)[:, None], points[segment], found)
        found = np.where((local >= 1)[:, None], points[segment + 1], found)
        return _with_ends(found, parameter, points[0], points[-1])

    return place


def _with_ends(found: FloatArray, parameter: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    found[parameter < _END] = first
    found[parameter > 1 - _END] = last
    return found


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
