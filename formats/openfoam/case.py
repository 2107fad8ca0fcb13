"""OpenFOAM cases: a folder with ``system`` and ``constant``, or the file ``NAME.foam`` in it that ParaView opens."""

from __future__ import annotations

from pathlib import Path

from meshdeform_core.errors import FormatError

_DICTIONARIES = ("system/blockMeshDict", "constant/polyMesh/blockMeshDict")
POLY_MESH = Path("constant") / "polyMesh"


def is_case(path: Path) -> bool:
    """Whether a path is an OpenFOAM case: a folder with ``system`` or ``constant``, or a ``.foam`` file."""
    return path.suffix.lower() == ".foam" or any((path / name).is_dir() for name in ("system", "constant"))


def case_folder(path: Path) -> Path:
    """The folder of a case."""
    return path.parent if path.suffix.lower() == ".foam" and not path.is_dir() else path


def dictionary_of(path: Path) -> Path:
    """The blockMeshDict of a case.

    Raises
    ------
    FormatError
        When it has none.
    """
    folder = case_folder(path)
    for name in _DICTIONARIES:
        if (folder / name).is_file():
            return folder / name
    if (folder / POLY_MESH).is_dir():
        raise FormatError(
            f"{folder} is an OpenFOAM case whose mesh (constant/polyMesh) is unstructured; a case can be read if it "
            "has a system/blockMeshDict"
        )
    raise FormatError(f"{folder} has no {_DICTIONARIES[0]}; expected an OpenFOAM case with one")
