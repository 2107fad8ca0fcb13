"""Results of Nastran: displacements and mode shapes from ``.op2``, nodes and elements from the bulk data file.

Both are read by pyNastran (extra ``nastran``).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray

from .results import SHELLS, Displacements, Results, outer_faces, surface_results

_CORNERS = {
    "CTRIA3": 3, "CTRIAR": 3, "CTRIA6": 3, "CQUAD4": 4, "CQUADR": 4, "CQUAD8": 4,
    "CTETRA": 4, "CPYRAM": 5, "CPENTA": 6, "CHEXA": 8,
}  # fmt: skip
_SHELLS = ("CTRIA", "CQUAD")
_RECTANGULAR = ("CORD1R", "CORD2R")


def read(path: Path, geometry: Path) -> Results:
    """Read the real displacements and eigenvectors of all subcases, in the basic coordinate system.

    Raises
    ------
    FormatError
        When pyNastran is missing or cannot read a file, there is no displacement, it is complex, or in cylindrical or
        spherical coordinates.
    """
    model, results = _models(path, geometry)
    numbers: IntArray = np.array(sorted(model.nodes), dtype=np.int64)
    points = np.array([model.nodes[n].get_position() for n in numbers]).reshape(len(numbers), 3)
    found = []
    for label, own, values in _displacements(path, results):
        missing = [int(n) for n in own if int(n) not in model.nodes and int(n) not in model.spoints]
        if missing:
            raise FormatError(f"{geometry} does not have the node {missing[0]} of {path}; expected its bulk data file")
        grid = np.array([int(n) in model.nodes for n in own], dtype=bool)
        found.append(Displacements(label, own[grid], _basic(geometry, model, own[grid], values[grid])))
    return surface_results(path, numbers, points, _faces(model), found)


def _models(path: Path, geometry: Path) -> tuple[Any, Any]:
    try:
        from pyNastran.bdf.bdf import BDF
        from pyNastran.op2.op2 import OP2
    # pyNastran versions that do not fit the installed numpy raise AttributeError.
    except (ImportError, AttributeError) as error:
        raise FormatError(
            f"{path}: reading .op2 files needs pyNastran (pip install 'meshdeform[nastran]'): {error}"
        ) from error
    model, results = BDF(debug=None), OP2(debug=None)
    for read, file in ((model.read_bdf, geometry), (results.read_op2, path)):
        try:
            read(str(file))
        # On damaged files, pyNastran raises exceptions of any type.
        except (Exception, SystemExit) as error:
            reason = str(error).strip().splitlines()
            raise FormatError(
                f"pyNastran cannot read {file}: {reason[0] if reason else type(error).__name__}"
            ) from error
    return model, results


def _displacements(path: Path, results: Any) -> Iterator[tuple[str, IntArray, FloatArray]]:
    """Label, node numbers (n,) and translations (n, 3) of every displacement."""
    for kind in (results.eigenvectors, results.displacements):
        for case, table in kind.items():
            if np.iscomplexobj(table.data):
                raise FormatError(f"{path}: the displacements of subcase {case} are complex; expected real ones")
            numbers = np.asarray(table.node_gridtype[:, 0], dtype=np.int64)
            for number, values in enumerate(table.data):
                label = f"subcase {case}, number {number + 1}"
                if kind is results.eigenvectors and hasattr(table, "mode_cycles"):
                    label += f" ({float(table.mode_cycles[number]):g} Hz)"
                yield label, numbers, np.asarray(values[:, :3], dtype=np.float64)


def _basic(geometry: Path, model: Any, numbers: IntArray, values: FloatArray) -> FloatArray:
    """Displacements (n, 3), given in the coordinate system that each node names, in the basic one."""
    frames = np.array([model.nodes[int(n)].Cd() for n in numbers])
    turned = values.copy()
    for frame in np.unique(frames):
        if frame == 0:
            continue
        system = model.coords[int(frame)]
        if system.type not in _RECTANGULAR:
            raise FormatError(
                f"{geometry}: nodes have displacements in the coordinate system {frame} ({system.type}); expected "
                f"rectangular ones"
            )
        own = frames == frame
        turned[own] = values[own] @ system.beta()
    return turned


def _faces(model: Any) -> list[IntArray]:
    """Faces of shells, and of the outside of solids."""
    shells: dict[int, list[list[int]]] = {corners: [] for corners in SHELLS}
    solids: dict[int, list[list[int]]] = {}
    for element in model.elements.values():
        corners = _CORNERS.get(element.type)
        if corners is not None:
            kind = shells if element.type.startswith(_SHELLS) else solids
            kind.setdefault(corners, []).append(list(element.node_ids[:corners]))
    own = [np.array(cells, dtype=np.int64) for cells in shells.values() if cells]
    return [*own, *outer_faces([np.array(cells, dtype=np.int64) for cells in solids.values()])]
