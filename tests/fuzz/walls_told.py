"""What a case says of the nodes of a small grid, worked out once more: tomllib, Python's eval and sets of corners."""

import ast
import fnmatch
import itertools
import tomllib
from collections import Counter
from typing import Any

import numpy as np

from meshdeform_core.grid import Grid

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
