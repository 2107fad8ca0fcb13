"""Classes of mutated displacement tables: nodes at points of the table, or on its surface, move as it says."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import h5py
import numpy as np
from grids import SPANS, stretched

from meshdeform_core.errors import MeshDeformError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid

from .bench import Bench, called, refusal, seeded
from .judges import silent_vtk
from .mutations import mutated, tags

VARIANTS = {
    ".vtu": ("ascii", "binary"),
    ".vtp": ("ascii", "binary"),
    ".vtk": ("ascii", "binary", "poly ascii", "poly binary"),
}
_NEAR = 1e-9


Surface = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points (n, 3), displacements (n, 3), triangles (m, 3)."""


def write_surface(path: Path, surface: Surface, kind: str) -> None:
    """Write a surface; ``kind`` tells which variant of the format."""
    import pyvista  # takes a second, in every run of the tests that collects this module

    points, moves, triangles = surface
    mesh = pyvista.PolyData.from_regular_faces(points, triangles) if len(triangles) else pyvista.PolyData(points)
    mesh.point_data["displacement"] = moves
    mesh = mesh if path.suffix == ".vtp" or "poly" in kind else mesh.cast_to_unstructured_grid()
    mesh.save(path, binary="ascii" not in kind)


def read_surface(path: Path) -> Surface | None:
    """The surface as vtk reads it; none if it finds no surface."""
    import pyvista

    try:
        with silent_vtk():
            mesh = pyvista.read(path)
        vectors = [np.asarray(values) for values in mesh.point_data.values() if values.shape[1:] == (3,)]
    except Exception:
        return None
    triangles = []
    for cell in map(mesh.get_cell, range(mesh.n_cells)):
        if cell.type in (pyvista.CellType.TRIANGLE, pyvista.CellType.POLYGON):
            corners = list(cell.point_ids)
            triangles += [[corners[0], *corners[n : n + 2]] for n in range(1, len(corners) - 1)]
    found = np.array(triangles, dtype=int).reshape(-1, 3)
    return (np.asarray(mesh.points, float), vectors[0].astype(float), found) if vectors else None


def prepare(bench: Bench) -> None:
    """Write a table of the body's nodes in the formats of arrays."""
    near = np.abs(bench.grid.points[:, :2]).max(axis=1) < 0.51
    points = np.unique(bench.grid.points[near], axis=0)
    moves = np.tile([0.05, 0.02, 0.0], (len(points), 1))
    np.savetxt("table.csv", np.hstack([points, moves]), "%.17g", delimiter=",")
    np.save("table.npy", np.hstack([points, moves]))
    np.savez("table.npz", points=points, displacement=moves)
    with h5py.File("table.h5", "w") as file:
        file["points"], file["displacement"] = points, moves


def array_table(names: tuple[str, ...], text: bool, bench: Bench, rng: Random) -> str:
    """A mutated table without triangles."""
    name = rng.choice(names)
    bad = Path(f"bad{Path(name).suffix}")
    bad.write_bytes(mutated(bench.valid[name], text, rng))
    return _moved(bad, bench, "nearest", lambda: _rows(bad))


def surface_table(suffix: str, bench: Bench, rng: Random) -> str:
    """A surface with triangles or without, coarse or at the nodes, damaged or not."""
    kind, triangles = rng.choice(VARIANTS[suffix]), rng.random() < 0.7
    path = Path(f"bad{suffix}")
    match = rng.choice(("nearest", "exact", "interpolate"))
    surface = body_surface(rng, coarse=match == "interpolate" and triangles)
    surface = surface if triangles else (*surface[:2], surface[2][:0])
    write_surface(path, surface, kind)
    data, how = path.read_bytes(), rng.randrange(4)
    if how == 1 and suffix in (".vtu", ".vtp"):
        data = tags(data, rng)
    elif how:
        data = mutated(data, "ascii" in kind, rng)
    path.write_bytes(data)
    # Where the witness finds nothing, what was accepted must be what was written.
    result = _moved(path, bench, match, lambda: read_surface(path) or surface)
    return result if how or result == "ok" else f"a good table: {result}"


def body_surface(rng: Random, coarse: bool) -> Surface:
    """The four sides of the body of ``frame(2, 2)``: at its nodes, or with one quad a side."""
    numbers = seeded(rng)
    line = np.array([-0.5, 0.5]) if coarse else np.unique(stretched(SPANS[1], 3))
    levels = np.array([0.0, 1.0]) if coarse else np.array([0.0, 0.5, 1.0])
    ring = [(a, -0.5) for a in line[:-1]] + [(0.5, a) for a in line[:-1]]
    ring += [(a, 0.5) for a in line[:0:-1]] + [(-0.5, a) for a in line[:0:-1]]
    points = np.array([(x, y, z) for z in levels for x, y in ring])
    # A linear field and a little more, so that neither cells fold nor neighbours move alike.
    moves = 0.03 * (points @ numbers.uniform(-1, 1, (3, 3))) + numbers.uniform(-0.01, 0.01, points.shape)
    if rng.random() < 0.5:
        moves[:, 2] = 0.0
    n, quads = len(ring), []
    for level in range(len(levels) - 1):
        for at in range(n):
            low, next_ = level * n + at, level * n + (at + 1) % n
            quads += [(low, next_, next_ + n), (low, next_ + n, low + n)]
    return points, moves, np.array(quads)


def _moved(path: Path, bench: Bench, match: str, read: Callable[[], Surface]) -> str:
    arguments = ("deform", "grid.xyz", "-d", str(path), "--match", match, "-m", "tfi", "-o", "out.xyz", "--force", "-q")
    code, told = called(*arguments, "--allow-invalid")
    if code != 0:
        return refusal(code, told)
    points, moves, triangles = read()
    try:
        after = read_grid("out.xyz")
    except MeshDeformError as error:
        # Walls that were moved to 1e15 leave nothing of a grid between them.
        return "ok" if "cells became invalid" in told else f"the output is refused: {error}"
    if match == "interpolate" and len(triangles):
        return _on_surface(points, moves, triangles, bench.grid, after) or "ok"
    return _at_points(points, moves, bench.grid, after) or "ok"


def _at_points(points: np.ndarray, moves: np.ndarray, before: Grid, after: Grid) -> str:
    """Every node at a point of the table moves as the table says."""
    known = {tuple(point): move for point, move in zip(points.tolist(), moves.tolist(), strict=True)}
    for old, new in zip(before.points.tolist(), after.points.tolist(), strict=True):
        told = known.get(tuple(old))
        if told is not None and np.abs(np.subtract(new, old) - told).max() > 1e-9 * max(1.0, np.abs(new).max()):
            return f"the node {old} moved by {np.subtract(new, old).tolist()}, the table says {told}"
    return ""


def _on_surface(points: np.ndarray, moves: np.ndarray, triangles: np.ndarray, before: Grid, after: Grid) -> str:
    """Every outside node on a triangle of the table moves as one of the triangles there says."""
    corners, values = points[triangles], moves[triangles]
    walls = np.abs(before.points[:, :2]).max(axis=1) < 0.51
    # Weights are known to 1e-16, whatever they multiply.
    size = max(1.0, np.abs(values).max())
    for old, new in zip(before.points[walls], after.points[walls], strict=True):
        told = [value for triangle, value in map(partial(_inside, old), corners, values) if triangle]
        if told and min(np.abs(new - old - value).max() for value in told) > 1e-7 * size:
            return f"the node {old.tolist()} moved by {(new - old).tolist()}, the table says {told[0].tolist()}"
    return ""


def _inside(point: np.ndarray, corners: np.ndarray, values: np.ndarray) -> tuple[bool, np.ndarray]:
    """Whether a point lies on a triangle, and the value there."""
    edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
    weights, *_ = np.linalg.lstsq(edges, point - corners[0], rcond=None)
    one, two = weights.tolist()
    apart = np.abs(edges @ weights - (point - corners[0])).max()
    value = values[0] + one * (values[1] - values[0]) + two * (values[2] - values[0])
    return bool(apart < _NEAR and min(one, two, 1 - one - two) > -_NEAR), value


def _rows(path: Path) -> Surface:
    """Points and displacements of a table without triangles."""
    if path.suffix == ".npy":
        rows = np.load(path, allow_pickle=False).astype(float)
    elif path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            rows = np.hstack(list(archive.values())).astype(float)
    elif path.suffix == ".h5":
        with h5py.File(path) as file:
            rows = np.hstack([file["points"][()], file["displacement"][()]]).astype(float)
    else:
        return text_table(path)
    return rows[:, :3], rows[:, 3:6], np.empty((0, 3), int)


def text_table(path: Path) -> Surface:
    """Points and displacements of lines of six numbers."""
    rows = []
    for line in path.read_text("utf-8", "replace").splitlines():
        try:
            row = [float(word) for word in re.split(r"[,;\s]+", line.partition("#")[0].strip())]
        except ValueError:
            continue
        if len(row) == 6:
            rows.append(row)
    table = np.array(rows).reshape(-1, 6)
    return table[:, :3], table[:, 3:], np.empty((0, 3), int)


KINDS = {
    "table, text": partial(array_table, ("table.csv",), True),
    "table, numpy": partial(array_table, ("table.npy", "table.npz"), False),
    "table, HDF5": partial(array_table, ("table.h5",), False),
    **{f"table, {suffix}": partial(surface_table, suffix) for suffix in VARIANTS},
}
