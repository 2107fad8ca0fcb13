"""Results of structural solvers: several displacements, such as mode shapes, of one model in a file."""

from __future__ import annotations

from pathlib import Path

from meshdeform_core.boundary.tables.matching import SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.wording import listed

from ..table import DisplacementTable, checked_surface, row_place
from .results import Results

__all__ = ["read_shapes", "read_single"]


def read_shapes(path: Path, geometry: Path | None = None) -> tuple[SurfaceData, ...]:
    """All displacements of a result file, in its order: CalculiX ``.frd``, Nastran ``.op2`` with its ``.bdf``.

    Points and triangles are those of the outer surface of the model; of beams, all points.

    Parameters
    ----------
    geometry : the bulk data file, which has the nodes of an ``.op2``

    Raises
    ------
    FormatError
        When a file is damaged, has no displacement, or pyNastran is needed and missing.
    """
    results = _read(path, geometry)
    return tuple(checked_surface(_table(results, number), path) for number in range(len(results.shapes)))


def read_single(path: Path) -> DisplacementTable:
    """The displacement of a result file that has only one.

    Raises
    ------
    FormatError
        When it has several; the message lists them.
    """
    results = _read(path, None)
    if len(results.shapes) > 1:
        labels = listed((f"{number}: {label}" for number, label in enumerate(results.labels, start=1)), "; ")
        raise FormatError(
            f"{path} has {len(results.shapes)} displacements ({labels}), but a table has one. Use them in a case as "
            f"modes = {{ file = ..., shapes = [...], amplitudes = [...] }}"
        )
    return _table(results, 0)


def _read(path: Path, geometry: Path | None) -> Results:
    suffix = path.suffix.lower()
    if suffix not in (".frd", ".op2"):
        raise FormatError(f"{path} is not a result file of a structural solver; expected CalculiX .frd or Nastran .op2")
    if suffix == ".frd":
        if geometry is not None:
            raise FormatError(f"{path} has its own nodes; omit geometry = {geometry.name!r}")
        from . import frd

        return frd.read(path)
    if geometry is None:
        raise FormatError(
            f'{path} has no nodes; use it in a case with its bulk data file: modes = {{ file = "{path.name}", '
            f'geometry = "{path.stem}.bdf", amplitudes = [...] }}'
        )
    from . import nastran

    return nastran.read(path, geometry)


def _table(results: Results, number: int) -> DisplacementTable:
    return DisplacementTable(results.points, results.shapes[number], results.triangles, row_place)
