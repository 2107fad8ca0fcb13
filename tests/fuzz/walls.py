"""The class of grids with all kinds of boundaries: walls, slip planes, symmetry, periodic pairs."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
from grids import frame

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid

from .bench import METHODS, Bench

Entry = dict[str, str]


def constrained(bench: Bench, rng: Random) -> str:
    """A body between planes on which nodes slide, repeat or are mirrored."""
    grid = _bent(frame(rng.choice((1, 2)), rng.choice((1, 2, 3))), rng)
    write_grid(grid, "walls.xyz")
    entries, pairs = _entries(rng)
    text = _toml(entries)
    Path("walls.toml").write_text(text)
    repair = rng.choice(("auto", "auto", "off", "polish"))
    method, steps = rng.choice(METHODS), rng.choice(("1", "3", "auto"))
    arguments = ("walls.xyz", "-c", "walls.toml", "-m", method, "--steps", steps, "--repair", repair)
    Path("out.xyz").unlink(missing_ok=True)
    result = bench.deformed(read_grid("walls.xyz"), text, *arguments)
    if result != "ok" or not Path("out.xyz").exists():
        return result
    return _constraints(entries, pairs, grid, read_grid("out.xyz")) or "ok"


def _bent(grid: Grid, rng: Random) -> Grid:
    """The same grid with lines that are not straight; boundaries stay planes."""
    strength = rng.choice((0.0, 0.02))
    x, y, _ = grid.points.T
    inner = (np.abs(np.abs(x) - 0.5) > 1e-9) & (np.abs(np.abs(y) - 0.5) > 1e-9) & (np.maximum(abs(x), abs(y)) < 1.999)
    points = grid.points.copy()
    points[:, 0] += inner * strength * np.sin(3 * y)
    points[:, 1] += inner * strength * np.cos(2 * x)
    return grid.moved(points)


def _entries(rng: Random) -> tuple[list[Entry], list[int]]:
    """Entries of the body, of each pair of planes, and the axes whose planes are periodic."""
    size = rng.choice((0.02, 0.1, 0.3))
    motion = rng.choice(
        (
            f"rotate = {{ angle = {100 * size}, axis = [0, 0, 1] }}",
            f"displace = ['{size}*sin(2*y)', '{size}*x', 0]",
            f"translate = [{size}, {-size}, 0]",
            f"displace = ['{size}*cos(pi*z)', 0, '{size}*x*z*(1-z)']",
        )
    )
    body = {"select": "['*.i*', '*.j*']", "where": "'max(abs(x), abs(y)) < 0.51'", "motion": f"[{{ {motion} }}]"}
    entries, pairs = [body], []
    sides = {0: "abs(x) > 1.999", 1: "abs(y) > 1.999"}
    for axis in range(3):
        kind = rng.choice(("slip", "symmetry", "periodic", "fixed", "free", ""))
        # The end planes of a grid one cell thick are slip planes if nothing selects them.
        if not kind and axis < 2:
            continue
        kind = kind or "slip"
        select = "['*.kmin', '*.kmax']" if axis == 2 else f"['*.{'ij'[axis]}*']"
        where = {} if axis == 2 else {"where": f"'{sides[axis]}'"}
        entries.append({"select": select, **where, "kind": f"'{kind}'"})
        pairs += [axis] if kind == "periodic" else []
    rng.shuffle(entries)
    return entries, pairs


def _toml(entries: list[Entry]) -> str:
    return "".join("[[boundary]]\n" + "".join(f"{k} = {v}\n" for k, v in entry.items()) for entry in entries)


def _constraints(entries: list[Entry], pairs: list[int], before: Grid, after: Grid) -> str:
    """Nodes on planes of slip and symmetry stay in them; the two sides of a periodic pair move alike."""
    ends = ((-2.0, 2.0), (-2.0, 2.0), (0.0, 1.0))
    moves = after.points - before.points
    prescribed = np.abs(before.points[:, :2]).max(axis=1) < 0.51
    for entry in entries:
        axis = 2 if ".k" in entry["select"] else 0 if ".i" in entry["select"] else 1
        if entry.get("kind") not in ("'slip'", "'symmetry'") or "motion" in entry:
            continue
        on = np.isin(before.points[:, axis], ends[axis]) & ~prescribed
        if np.abs(moves[on, axis]).max(initial=0) > 1e-9:
            return f"nodes have left the plane across axis {axis}"
    for axis in pairs:
        others = [a for a in range(3) if a != axis]
        low, high = ends[axis]
        by_place = {}
        for side in (low, high):
            rows = np.flatnonzero((before.points[:, axis] == side) & ~prescribed)
            by_place[side] = {tuple(before.points[row, others].tolist()): moves[row] for row in rows}
        for place, move in by_place[low].items():
            if place not in by_place[high] or np.abs(by_place[high][place] - move).max() > 1e-9:
                return f"the periodic nodes at {place} across axis {axis} move apart"
    return ""


KINDS = {"slip, symmetry, periodic": constrained}
