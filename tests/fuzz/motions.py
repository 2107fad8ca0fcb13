"""Classes of mutated files of motions and of OpenFOAM: what is accepted must be what a plain reading finds."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
from grids import CASE
from poly_mesh_witness import read_points
from scipy.spatial.transform import Rotation, Slerp

from meshdeform_formats import read_grid, write_grid

from .bench import Bench, called, refusal, seeded
from .mutations import mutated

Told = Callable[[np.ndarray], np.ndarray]
_TIME = 0.4
_DICTIONARY = """\
FoamFile {{ version 2.0; format ascii; class dictionary; object blockMeshDict; }}
scale {scale};
vertices
(
{vertices}
);
blocks
(
    hex (0 1 4 3 6 7 10 9) (3 2 2) simpleGrading (1 1 1)
    hex (1 2 5 4 7 8 11 10) (2 2 2) simpleGrading (2 1 1)
);
boundary
(
    inlet {{ type patch; faces ((0 6 9 3)); }}
    walls {{ type wall; faces ((0 1 7 6) (1 2 8 7)); }}
);
"""


def _wall(bench: Bench) -> np.ndarray:
    """Rows of the nodes of the body."""
    return np.flatnonzero(np.abs(bench.grid.points[:, :2]).max(axis=1) < 0.51)


def _moved(step: str, bench: Bench, told: Callable[[], Told]) -> str:
    """The body moves as ``told`` says, a function of its points."""
    case = re.sub(r"motion = .*", f"motion = [{{ {step} }}]", CASE)
    Path("given.toml").write_text(case)
    arguments = ("deform", "grid.xyz", "-c", "given.toml", "--time", str(_TIME), "-m", "tfi", "-q", "--repair", "off")
    code, said = called(*arguments, "--steps", "1", "-o", "out.xyz", "--force", "--allow-invalid")
    if code != 0:
        return refusal(code, said)
    rows = _wall(bench)
    before, after = bench.grid.points[rows], read_grid("out.xyz").points[rows]
    expected = before + told()(before)
    apart = np.abs(after - expected).max(axis=1)
    worst = int(np.argmax(apart))
    if not apart[worst] <= 1e-9 * max(1.0, np.abs(expected[worst]).max()):
        return (
            f"the node {before[worst].tolist()} is at {after[worst].tolist()}, the file says {expected[worst].tolist()}"
        )
    return "ok"


def _columns(path: Path) -> tuple[list[str], np.ndarray]:
    text = path.read_text("utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip()]
    split = [next(csv.reader([re.sub(r"[\s;]+", ",", line.strip())])) for line in lines]
    split = [[word for word in words if word] for words in split]
    return split[0], np.array(split[1:], dtype=float)


def rigid_body(bench: Bench, rng: Random) -> str:
    """Translation with angles or quaternions, at three times."""
    numbers, turns = seeded(rng), rng.random() < 0.5
    shift = numbers.uniform(-0.05, 0.05, (3, 3)) * [1, 1, 0]
    angle = np.stack([np.zeros(3), np.zeros(3), numbers.uniform(-8, 8, 3)], axis=1)
    turn = Rotation.from_euler("xyz", angle, degrees=True).as_quat() if turns else angle
    head = "t,x,y,z," + ("qx,qy,qz,qw" if turns else "rx,ry,rz")
    rows = np.hstack([[[0.0], [0.5], [1.0]], shift, turn])
    text = "\n".join([head, *(",".join(f"{v:.17g}" for v in row) for row in rows), ""])
    Path("bad.csv").write_bytes(mutated(text.encode(), True, rng))
    order = "" if turns else ', order = "ZYX"'

    def told() -> Told:
        names, table = _columns(Path("bad.csv"))
        column = {name: table[:, n] for n, name in enumerate(names)}
        times = table[:, 0]
        moved = [np.interp(_TIME, times, column.get(name, 0 * times)) for name in "xyz"]
        if "qx" in column:
            given = Rotation.from_quat(np.stack([column[f"q{name}"] for name in "xyzw"], axis=1))
            turned = Slerp(times, given)(_TIME) if len(times) > 1 else given[0]
        else:
            zyx = [np.interp(_TIME, times, column.get(f"r{name}", 0 * times)) for name in "zyx"]
            turned = Rotation.from_euler("ZYX", zyx, degrees=True)
        return lambda x: turned.apply(x) + moved - x

    return _moved(f'rigid = {{ file = "bad.csv"{order} }}', bench, told)


def dictionary(bench: Bench, rng: Random) -> str:
    """A blockMeshDict of two blocks."""
    numbers = seeded(rng)
    corners = [[i + 0.2 * numbers.uniform(), j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1, 2)]
    vertices = "\n".join("    (" + " ".join(f"{v:.6g}" for v in corner) + ")" for corner in corners)
    text = _DICTIONARY.format(scale=rng.choice(("1", "0.5", "1e-3")), vertices=vertices)
    Path("blockMeshDict").write_bytes(mutated(text.encode(), True, rng))
    code, said = called("convert", "blockMeshDict", "copy.xyz", "--force", "-q")
    if code != 0:
        return refusal(code, said)
    grid = read_grid("blockMeshDict")
    scale, points, blocks = _plain_dictionary(Path("blockMeshDict").read_text("utf-8-sig", "replace"))
    if len(blocks) != grid.n_blocks:
        return f"{grid.n_blocks} blocks, the file has {len(blocks)}"
    for number, (nodes, cells) in enumerate(blocks):
        if grid.shapes[number] != tuple(n + 1 for n in cells):
            return f"block {number} has {grid.shapes[number]} nodes, the file says {cells} cells"
        x = grid.block(number)
        found = x[[0, -1, -1, 0, 0, -1, -1, 0], [0, 0, -1, -1, 0, 0, -1, -1], [0, 0, 0, 0, -1, -1, -1, -1]]
        if not np.allclose(found, scale * points[nodes], rtol=1e-12, atol=1e-14 * np.abs(points).max() * scale):
            return f"the corners of block {number} are {found.tolist()}"
    return "ok"


def _plain_dictionary(text: str) -> tuple[float, np.ndarray, list[tuple[list[int], list[int]]]]:
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    scale = re.findall(r"\b(?:scale|convertToMeters)\s+(\S+?)\s*;", text)
    body = re.findall(r"\bvertices\s*\((.*?)\)\s*;", text, flags=re.DOTALL)[-1]
    points = np.array([row.split() for row in re.findall(r"\(([^()]*)\)", body + ")")], dtype=float)
    # Of entries that come twice, the last one counts.
    text = re.findall(r"\bblocks\s*\(.*?\)\s*;", text, flags=re.DOTALL)[-1]
    found = re.findall(r"\bhex\s*\(([^)]*)\)\s*(?:\w+\s*)?\(([^)]*)\)", text)
    blocks = [([int(n) for n in nodes.split()], [int(n) for n in cells.split()]) for nodes, cells in found]
    return float(scale[-1]) if scale else 1.0, points, blocks


def mesh_points(binary: bool, bench: Bench, rng: Random) -> str:
    """The points of the mesh of a case with a dictionary."""
    shutil.rmtree("case", ignore_errors=True)
    (Path("case") / "system").mkdir(parents=True)
    corners = [f"    ({i} {j} {k})" for k in (0, 1) for j in (0, 1) for i in (0, 1, 2)]
    Path("case/system/blockMeshDict").write_text(_DICTIONARY.format(scale="1", vertices="\n".join(corners)))
    write_grid(read_grid("case"), "case/case.foam", {"encoding": "binary" if binary else "ascii"})
    path = Path("case/constant/polyMesh/points")
    path.write_bytes(mutated(path.read_bytes(), not binary, rng))
    code, said = called("convert", "case", "copy.xyz", "--force", "-q")
    if code != 0:
        return refusal(code, said)
    grid, points = read_grid("case"), {tuple(x) for x in read_points(path).tolist()}
    strange = [x for x in grid.points.tolist() if tuple(x) not in points]
    if strange:
        return f"the node {strange[0]} is no point of the file"
    plain = read_grid("case/system/blockMeshDict").points
    if np.abs(grid.points - plain).max() > 1e-3:
        return "a node is not where the dictionary puts it"
    return "ok"


KINDS: dict[str, Callable[[Bench, Random], str]] = {
    "rigid body": rigid_body,
    "blockMeshDict": dictionary,
    "polyMesh points, ASCII": partial(mesh_points, False),
    "polyMesh points, binary": partial(mesh_points, True),
}
