"""Independent readings of files and results: numpy, struct, h5py and the XML parser of Python, none of our readers."""

import ast
import contextlib
import fnmatch
import itertools
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from cgns_witness import N
from grids import joined_nodes
from plot3d_witness import binary_file

from meshdeform_core.grid import Grid


def plot3d_binary(path: Path, grid: Grid) -> str:
    """The bytes of the file, written again from what was read."""
    options = {key: value for key, value in grid.format.options.items() if key != "iblank"}
    if any(field.name.lower() == "iblank" for field in grid.fields):
        flags = [next(f.values for f in grid.fields if f.block == b).astype(np.int32) for b in range(grid.n_blocks)]
    else:
        flags = None
    blocks = [np.asarray(grid.block(b)) for b in range(grid.n_blocks)]
    again = binary_file(blocks, flags, **options, precision=grid.precision)
    return "" if again == path.read_bytes() else "the file is not what was read"


def plot3d_text(path: Path, grid: Grid) -> str:
    """All numbers of the text are those of the grid in the order of the format, from the first to the last."""
    words = [word for word in re.split(r"[\s,]+", path.read_text("utf-8-sig", "replace")) if word]
    dimension = int(grid.format.options["dimension"])
    shapes = [n for block in range(grid.n_blocks) for n in grid.shapes[block][:dimension]]
    expected: list[float] = [grid.n_blocks, *shapes] if grid.format.options["multiblock"] else [*shapes]
    for block in range(grid.n_blocks):
        for axis in range(dimension):
            expected += grid.block(block)[..., axis].ravel(order="F").tolist()
        flags = [field.values for field in grid.fields if field.block == block and field.name.lower() == "iblank"]
        expected += [float(flag) for values in flags for flag in values.ravel(order="F")]
    found = _fortran_numbers(words)
    return "" if found == expected else "the numbers are not those of the text"


def _fortran_numbers(words: list[str]) -> list[float]:
    values: list[float] = []
    for word in words:
        count, star, value = word.rpartition("*")
        # Fortran leaves the letter of an exponent away: 1.5-1 is 0.15.
        number = re.sub(r"(?<=[\d.])(?=[+-])", "e", re.sub("[dDqQ]", "e", value)) or "nan"
        values += [float(number)] * (int(count) if star else 1)
    return values


def cgns_tree(tree: N, path: Path, grid: Grid) -> str:
    """Coordinates and number of zones are those of a base of the tree from which the file was written."""
    found = [_cgns_base(base, grid) for base in tree.children if base.label == "CGNSBase_t"]
    return "" if not found or "" in found else found[0]


def _cgns_base(base: N, grid: Grid) -> str:
    zones = [zone for zone in base.children if zone.label == "Zone_t" and not zone.link]
    links = [zone for zone in base.children if zone.link]
    if not len(zones) <= grid.n_blocks <= len(zones) + len(links):
        return f"{grid.n_blocks} blocks of {len(zones)} zones"
    for zone in zones:
        found = [child for child in zone.children if child.label == "GridCoordinates_t"]
        holder = next((child for child in found if child.name == "GridCoordinates"), found[0] if found else None)
        if holder is None or holder.link or zone.name not in grid.names:
            continue
        block = grid.block(grid.names.index(zone.name))
        rind = next((np.array(child.data) for child in holder.children if child.label == "Rind_t"), np.zeros(6, int))
        core = tuple(slice(int(low), -int(high) or None) for low, high in rind.reshape(-1)[:6].reshape(-1, 2))
        for axis, letter in enumerate("XYZ"):
            arrays = [child.data for child in holder.children if child.name == f"Coordinate{letter}" and not child.link]
            if arrays and not np.array_equal(np.asarray(arrays[0], float)[core], block[..., axis]):
                return f"{zone.name}: Coordinate{letter} is not what was written"
    return ""


def vtk_points(path: Path, grid: Grid) -> str:
    """The points that the vtk package reads, or, where it reads nothing, those before the change."""
    import vtk_witness

    with silent_vtk():
        try:
            points = vtk_witness.read(path)[0]
        except AttributeError:
            points = vtk_witness.read(path.with_stem("good"))[0]
    return "" if np.array_equal(points, grid.block(0)) else "the points are not those that vtk reads"


@contextlib.contextmanager
def silent_vtk() -> Iterator[None]:
    """Damaged files make vtk talk."""
    from vtkmodules.vtkCommonCore import vtkObject

    vtkObject.GlobalWarningDisplayOff()
    yield


def cgns(path: Path, grid: Grid) -> str:
    """Coordinate arrays as h5py finds them."""
    with h5py.File(path) as file:
        for base in (node for node in file.values() if isinstance(node, h5py.Group)):
            for name, zone in base.items():
                coordinates = zone.get("GridCoordinates") if isinstance(zone, h5py.Group) else None
                if coordinates is None or name not in grid.names:
                    continue
                block = grid.block(grid.names.index(name))
                for axis, letter in enumerate("XYZ"):
                    data = coordinates.get(f"Coordinate{letter}")
                    if data is not None and not np.array_equal(data[" data"][()].T, block[..., axis]):
                        return f"{name}: Coordinate{letter} is not what was read"
    return ""


def in_one_piece(path: Path, grid: Grid) -> str:
    """The bytes of every coordinate array stand in the file in one piece."""
    data = path.read_bytes()
    for block in range(grid.n_blocks):
        for axis in range(3):
            values = np.asarray(grid.block(block)[..., axis])
            if not any(values.astype(kind).tobytes(order="F") in data for kind in ("<f8", "<f4", ">f8", ">f4")):
                return f"coordinate {axis} of block {block} is not in the file"
    return ""


def vtm(path: Path, grid: Grid) -> str:
    """The points of the files that the index names, in its order."""
    root = ElementTree.fromstring(path.read_bytes())
    files = [path.parent / node.get("file") for node in root.iter("DataSet") if node.get("file")]
    if len(files) != grid.n_blocks:
        return f"the index names {len(files)} files, {grid.n_blocks} blocks were read"
    for block, file in enumerate(files):
        data = ElementTree.fromstring(file.read_bytes()).find(".//Points/DataArray")
        found = np.array((data.text or "").split(), dtype=float)
        # Rows of points, i fastest.
        if not np.array_equal(found, np.transpose(grid.block(block), (2, 1, 0, 3)).ravel()):
            return f"block {block + 1} is not {file}"
    return ""


def neutral_map(path: Path, grid: Grid, told: str) -> str:
    """Nodes that a connection joins lie at one place, or a warning names it; every patch has a line of its own."""
    for link in grid.connections:
        if link.periodic is not None:
            continue
        nodes, donors = joined_nodes(grid, link)
        if np.abs(nodes - donors).max() > 1e-6 and f"connection {link.name!r}" not in told:
            return f"connection {link.name} joins nodes that lie apart"
    lines = [line for line in path.read_text(errors="replace").splitlines() if line.strip()[:1] not in ("", "#")]
    windows = sum(len(patch.windows) for patch in grid.patches) + len(grid.connections)
    return "" if windows <= len(lines) else "more patches than lines"


def newly_bad(before: Grid, after: Grid) -> int:
    """Cells with a corner that had a positive volume and has none."""
    count = 0
    for b in range(before.n_blocks):
        old, new = (_corner_volumes(grid.block(b)) for grid in (before, after))
        # How a block is wound is open when its corners, its cells and its volume do not agree.
        wound = {np.sign(x) or 1.0 for x in (np.sign(old).sum(), np.sign(old.sum(axis=0)).sum(), old.sum())}
        count += min(int(((sign * old > 0) & (sign * new <= 0)).any(axis=0).sum()) for sign in wound)
    return count


def _corner_volumes(x: np.ndarray) -> np.ndarray:
    """(8, cells) triple products of the edges at the corners."""
    found = []
    for corner in np.ndindex(2, 2, 2):
        pick = tuple(slice(c, n - 1 + c) for c, n in zip(corner, x.shape, strict=False))
        edges = []
        for axis in range(3):
            other = list(pick)
            other[axis] = slice(1 - corner[axis], x.shape[axis] - corner[axis])
            edges.append((x[tuple(other)] - x[pick]) * (1 if corner[axis] == 0 else -1))
        found.append(np.einsum("...i,...i->...", edges[0], np.cross(edges[1], edges[2])).ravel())
    return np.array(found)


SIDES = ("imin", "imax", "jmin", "jmax", "kmin", "kmax")
_NAMES = [
    "sin", "cos", "tan", "exp", "sinh", "cosh", "tanh", "abs", "floor", "hypot", "sqrt", "log", "log2", "log10", "ceil",
    "sign", "mod", "arcsin", "arccos", "arctan", "arcsinh", "arccosh", "arctanh", "arctan2", "maximum", "minimum",
]  # fmt: skip
_FUNCTIONS = {
    **{name.replace("arc", "a").removesuffix("imum"): getattr(np, name) for name in _NAMES},
    "pi": np.float64(np.pi),
    "where": lambda condition, one, two: one if condition else two,
    "number": np.float64,
}


class _Numbers(ast.NodeTransformer):
    """Numbers as float64, so that 9**9**9 ends."""

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return ast.Call(ast.Name("number", ast.Load()), [ast.Constant(str(node.value))], [])


Quad = frozenset[tuple[float, ...]]


def outside_quads(grid: Grid) -> dict[tuple[int, str], list[Quad]]:
    """Corner points of the quads on every block face that no other face shares."""
    faces: dict[tuple[int, str], list[Quad]] = {}
    for block in range(grid.n_blocks):
        points = grid.block(block)
        for number, side in enumerate(SIDES):
            face = np.take(points, -(number % 2), axis=number // 2)
            rows = [[tuple(node) for node in line] for line in face.tolist()]
            faces[block, side] = [
                frozenset((rows[a][b], rows[a + 1][b], rows[a][b + 1], rows[a + 1][b + 1]))
                for a, b in itertools.product(range(len(rows) - 1), range(len(rows[0]) - 1))
            ]
    count = Counter(quad for quads in faces.values() for quad in quads)
    return {face: [quad for quad in quads if count[quad] == 1] for face, quads in faces.items()}


def formula_value(formula: Any, points: np.ndarray, constants: dict[str, float]) -> np.ndarray:
    """Values of a formula (or number) that the program has accepted, computed by Python at one point after another.

    Raises
    ------
    FloatingPointError
        Where a part of it is no number; which value the whole has then, tests of formulas know.
    """
    text = formula.strip() if isinstance(formula, str) else repr(float(formula))
    code = compile(ast.fix_missing_locations(_Numbers().visit(ast.parse(text, mode="eval"))), "formula", "eval")
    names = {"__builtins__": {}, **_FUNCTIONS, **{k: np.float64(v) for k, v in constants.items()}, "t": np.float64(0)}
    with np.errstate(all="raise", under="ignore"):
        return np.array([float(eval(code, {**names, **dict(zip("xyz", point, strict=True))})) for point in points])


def _moved(step: dict[str, Any], at: np.ndarray, points: np.ndarray, constants: dict[str, float]) -> np.ndarray:
    """Where one step of a motion takes nodes that lie ``at``, from undeformed ``points``."""
    ((kind, what),) = step.items()
    if kind in ("translate", "displace"):
        return at + np.stack([formula_value(formula, points, constants) for formula in what], axis=1)
    axis = np.array(what.get("axis", [0, 0, 1]), dtype=float)
    axis /= np.abs(axis).max()
    axis /= np.linalg.norm(axis)
    center = np.stack([formula_value(formula, points, constants) for formula in what.get("center", [0, 0, 0])], axis=1)
    angle = np.radians(formula_value(what["angle"], points, constants))[:, None]
    arm = at - center
    along = (arm @ axis)[:, None] * axis
    return center + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)


def walls_told(text: str, before: Grid, after: Grid) -> str:
    """Nodes of moving entries are where the motion takes them, those of fixed ones and slip planes stay there."""
    case = tomllib.loads(text)
    constants = {name: float(value) for name, value in case.get("constants", {}).items()}
    quads = outside_quads(before)
    kinds: dict[tuple[float, ...], tuple[int, Any]] = {}
    chosen_by_any: set[Quad] = set()
    for entry in case.get("boundary", []):
        patterns = entry.get("select", ["*"])
        patterns = [patterns] if isinstance(patterns, str) else patterns
        if any("[" in pattern for pattern in patterns) or any("file" in s or "files" in s for s in _steps(entry)):
            return ""
        chosen = _selected(entry, patterns, before, quads, constants)
        chosen_by_any |= chosen
        kind = entry.get("kind", "moving" if _steps(entry) else "fixed")
        rank = ["free", "periodic", "slip", "symmetry", "fixed", "moving"].index(kind)
        for node in {node for quad in chosen for node in quad}:
            if node not in kinds or kinds[node][0] < rank:
                kinds[node] = (rank, entry)
    for quad in set(itertools.chain(*quads.values())) - chosen_by_any:
        kinds |= {node: (4, {}) for node in quad if node not in kinds or kinds[node][0] < 4}
    return _compare(kinds, constants, before, after)


def _steps(entry: dict[str, Any]) -> list[dict[str, Any]]:
    steps = entry.get("motion", [])
    return [steps] if isinstance(steps, dict) else steps


def _selected(
    entry: dict[str, Any], patterns: list[str], grid: Grid, quads: dict[Any, list[Quad]], constants: dict[str, float]
) -> set[Quad]:
    chosen = set()
    for (block, side), found in quads.items():
        if any(fnmatch.fnmatchcase(f"block{block + 1}.{side}", pattern) or pattern == "*" for pattern in patterns):
            chosen |= set(found)
    if "where" not in entry:
        return chosen
    nodes = sorted({node for quad in chosen for node in quad})
    if not nodes:
        return chosen
    points = np.array(nodes)
    true = dict(zip(nodes, formula_value(entry["where"], points, constants), strict=True))
    return {quad for quad in chosen if all(true[node] != 0 for node in quad)}


def _compare(kinds: dict[Any, tuple[int, Any]], constants: dict[str, float], before: Grid, after: Grid) -> str:
    new = dict(zip(map(tuple, before.points.tolist()), after.points, strict=True))
    size = max(1.0, np.abs(after.points).max())
    for node, (rank, entry) in kinds.items():
        point = np.array([node])
        expected = point
        if rank == 5:
            for step in _steps(entry):
                expected = _moved(step, expected, point, constants)
        if rank >= 4 and np.abs(new[node] - expected[0]).max() > 1e-9 * size:
            return f"the node {node} is at {new[node].tolist()}, the case says {expected[0].tolist()}"
    for old, moved in zip(before.points.tolist(), after.points, strict=True):
        if not np.array_equal(new[tuple(old)], moved):
            return f"the node {old} has come apart"
    return ""
