"""What two other programs say of the grids before and after a repair: MFEM and OpenFOAM's checkMesh.

python studies/witnesses.py                           every motion of robustness_table.py, table on stdout
python studies/witnesses.py --only plate              some of them
python studies/witnesses.py --grids FOLDER            where third-party grids lie (default: MESHDEFORM_GRIDS)
python studies/witnesses.py --write studies/RESULTS.md  put the table in its place on the page

Needs `pip install mfem` (4.10 or later) or plot3dToFoam and checkMesh on the path (Debian: `apt install openfoam`);
columns whose program is not installed are left out.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from robustness_table import Trial, possible
from tables import Row, run

from meshdeform_core.deform import Timing, impose
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_formats.grids import write_grid

_CONTROL = (
    "application checkMesh; startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 1; writeInterval 1;"
)
_SCHEMES = "divSchemes {} gradSchemes {} laplacianSchemes {}"
_POINTS = 8
"""Of MFEM's bounds in each direction; more are closer."""
_LIMIT = 300
"""Seconds that a witness may take."""


@dataclass(frozen=True)
class Determinants:
    """What MFEM finds in the cells of a grid, of which each is one element.

    Attributes
    ----------
    sampled : (n_cells,) smallest Jacobian at corners and at the middles of edges, faces and cell
    bound : (n_cells,) no Jacobian of the cell is smaller: MFEM's piecewise linear bounds
    """

    sampled: FloatArray
    bound: FloatArray


def has_mfem() -> bool:
    return importlib.util.find_spec("mfem") is not None


def has_check_mesh() -> bool:
    return shutil.which("checkMesh") is not None and shutil.which("plot3dToFoam") is not None


def determinants(grid: Grid, handed: Grid) -> Determinants:
    """Jacobians by MFEM of all cells, positive where a block has the handedness that it has in ``handed``."""
    import mfem.ser as mfem

    sampled, bound = [], []
    for block in range(grid.n_blocks):
        nodes = grid.block(block, grid.points)
        flat = 2 if 1 in nodes.shape[:3] else 3
        text = _mfem_text(nodes, flat, _left_handed(handed.block(block, handed.points)))
        with tempfile.NamedTemporaryFile("w", suffix=".mesh") as file:
            file.write(text)
            file.flush()
            mesh = mfem.Mesh(file.name, 0, 0, False)
        mesh.EnsureNodes()
        # The Jacobian of an element of order 1 has the order d - 1 in each of its d coordinates.
        space = mfem.FiniteElementSpace(mesh, mfem.L2_FECollection(flat - 1, flat, mfem.BasisType.GaussLobatto))
        values, low, high = mfem.GridFunction(space), mfem.Vector(), mfem.Vector()
        mesh.UpdateJacobianDeterminantGF(values)
        values.GetElementBounds(mfem.PLBound(space, _POINTS), low, high)
        sampled.append(values.GetDataArray().reshape(mesh.GetNE(), -1).min(axis=1))
        bound.append(low.GetDataArray().copy())
    return Determinants(np.concatenate(sampled), np.concatenate(bound))


def _left_handed(nodes: FloatArray) -> bool:
    """Of a block (ni, nj, nk, 3), by the sum of the Jacobians at one corner of its cells."""
    axes = [axis for axis in range(3) if nodes.shape[axis] > 1]
    ends = tuple(slice(0, n - 1) if n > 1 else slice(None) for n in nodes.shape[:3])
    edges = [np.diff(nodes, axis=axis)[ends] for axis in axes]
    if len(axes) == 2:
        a, b = (edge[..., _plane(nodes)] for edge in edges)
        return bool((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum() < 0)
    return bool(np.einsum("...i,...i", edges[0], np.cross(edges[1], edges[2])).sum() < 0)


def _plane(nodes: FloatArray) -> list[int]:
    """The two coordinates that vary in a 2-D block."""
    extent = np.ptp(nodes.reshape(-1, 3), axis=0)
    return sorted(np.argsort(extent)[1:].tolist())


def _mfem_text(nodes: FloatArray, dimension: int, turned: bool) -> str:
    """A block as a file in MFEM's format; ``turned`` reverses its first direction, which changes the handedness."""
    numbers = np.arange(nodes[..., 0].size).reshape(nodes.shape[:3])
    kept = [n for n in nodes.shape[:3] if n > 1]
    numbers = numbers.reshape(kept)[::-1] if turned else numbers.reshape(kept)
    low, high = (slice(None, -1), slice(1, None))
    ring = ((low, low), (high, low), (high, high), (low, high))
    corners = [(*c, e) for e in (low, high) for c in ring] if dimension == 3 else ring
    cells = np.stack([numbers[corner] for corner in corners], axis=-1)
    # Reversed nodes give reversed cells; the results are wanted in the order of the grid.
    cells = (cells[::-1] if turned else cells).reshape(-1, len(corners))
    points = nodes.reshape(-1, 3) if dimension == 3 else nodes.reshape(-1, 3)[:, _plane(nodes)]
    kind = 5 if dimension == 3 else 3
    lines = [f"MFEM mesh v1.0\n\ndimension\n{dimension}\n\nelements\n{len(cells)}"]
    lines += [f"1 {kind} " + " ".join(map(str, cell)) for cell in cells.tolist()]
    lines += [f"\nboundary\n0\n\nvertices\n{len(points)}\n{dimension}"]
    lines += [" ".join(map(repr, point)) for point in points.tolist()]
    return "\n".join(lines) + "\n"


def check_mesh(grid: Grid) -> str:
    """Cells with negative volumes and wrongly oriented faces by checkMesh, like ``0 / 12``."""
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder)
        (case / "system").mkdir()
        for name, body in (("controlDict", _CONTROL), ("fvSchemes", _SCHEMES), ("fvSolution", "")):
            head = f"FoamFile {{ version 2.0; format ascii; class dictionary; object {name}; }}\n"
            (case / "system" / name).write_text(head + body)
        write_grid(_in_space(grid), case / "grid.fmt")
        _said(["plot3dToFoam", "-noBlank", "-case", folder, str(case / "grid.fmt")])
        said = _said(["checkMesh", "-case", folder])
    volumes = re.search(r"Number of negative volume cells[^\d]*(\d+)", said)
    faces = re.search(r"Error in face pyramids: (\d+) faces", said)
    return f"{volumes[1] if volumes else 0} / {faces[1] if faces else 0}"


def _in_space(grid: Grid) -> Grid:
    """A 2-D grid as one layer of cells, of a thickness like its cells'; a 3-D grid as it is."""
    if grid.dimension == 3:
        return grid
    blocks = []
    for block in range(grid.n_blocks):
        nodes = grid.block(block, grid.points)
        flat = nodes.shape.index(1)
        shift = np.zeros(3)
        shift[3 - sum(_plane(grid.points))] = np.linalg.norm(np.ptp(grid.points, axis=0)) / 100
        blocks.append(np.concatenate([nodes, nodes + shift], axis=flat))
    return Grid.from_blocks(blocks)


def _said(command: list[str]) -> str:
    # Debian's packages do not set the variable by which the programs find their settings.
    environment = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=_LIMIT)
    return done.stdout


def measure(trial: Trial) -> Row:
    """Invalid cells of one motion by all programs: without repair in one step, and with the defaults."""
    setup = trial.make()
    motion = trial.motion(setup)
    plain = impose(setup.with_repair("off"), motion, 1, "float64", Timing())
    final = impose(setup, motion, None, "float64", Timing())
    row: Row = {"motion": trial.label}
    sound = determinants(setup.grid, setup.grid).bound > 0 if has_mfem() else None
    for label, result in (("one step", plain), ("default", final)):
        row[f"{label}: meshdeform"] = result.assessment.after.invalid_cells
        if sound is not None:
            found = determinants(result.grid, setup.grid)
            wrong, proved = sound & (found.sampled <= 0), sound & (found.bound > 0)
            row[f"{label}: MFEM"] = f"{wrong.sum()} to {(sound & ~proved).sum()}"
        if has_check_mesh():
            row[f"{label}: checkMesh"] = check_mesh(result.grid)
    return row


def main() -> None:
    """The command line."""
    if not (has_mfem() or has_check_mesh()):
        sys.exit("neither MFEM (pip install mfem) nor OpenFOAM (plot3dToFoam and checkMesh) is installed")
    run(possible, lambda _, trial: measure(trial), __doc__, __file__)


if __name__ == "__main__":
    main()
