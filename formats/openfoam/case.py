"""OpenFOAM cases: a folder with ``system`` and ``constant``, or the file ``NAME.foam`` in it that ParaView opens."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from meshdeform_core import interruption
from meshdeform_core.errors import FormatError

from ..files import followed, partial_path, reason_of

_DICTIONARIES = ("system/blockMeshDict", "constant/polyMesh/blockMeshDict")
POLY_MESH = Path("constant") / "polyMesh"
_FILES = ("points", "faces", "owner", "neighbour", "boundary")
# Files that other tools write for the faces, cells and points of one particular mesh.
_DEPENDENT = ("cellZones", "faceZones", "pointZones", "sets", "cellLevel", "pointLevel", "surfaceIndex", "level0Edge",
              "refinementHistory", "meshModifiers", "cellDecomposition")  # fmt: skip
_CONTROL = """\
FoamFile
{
    version 2.0;
    format ascii;
    class dictionary;
    object controlDict;
}

application     pimpleFoam;
startFrom       startTime;
startTime       0;
stopAt          endTime;
endTime         1;
deltaT          1;
writeControl    timeStep;
writeInterval   1;
"""


def is_case(path: Path) -> bool:
    """Whether a path is an OpenFOAM case: a folder with ``system`` or ``constant``, or a ``.foam`` file."""
    return is_foam(path) or any((path / name).is_dir() for name in ("system", "constant"))


def is_foam(path: Path) -> bool:
    """Whether a path is the ``.foam`` file of a case."""
    return path.suffix.lower() == ".foam" and not path.is_dir()


def output_path(path: str | Path) -> Path:
    """The path of a grid that is written: of a folder, which is a case or ends with a slash, its ``.foam`` file."""
    folder = Path(path)
    if str(path).endswith("/") or any((folder / name).is_dir() for name in ("system", "constant")):
        return folder / f"{folder.absolute().name}.foam"
    return folder


def case_folder(path: Path) -> Path:
    """The folder of a case."""
    return path.parent if is_foam(path) else path


def dictionary_of(path: Path) -> Path | None:
    """The blockMeshDict of a case, without which it cannot be read."""
    places = (case_folder(path) / name for name in _DICTIONARIES)
    return next((place for place in places if place.is_file()), None)


def mesh_files(path: Path) -> list[Path]:
    """The existing files of the mesh of a case, including compressed ones."""
    mesh = case_folder(path) / POLY_MESH
    return [file for name in _FILES for file in (mesh / name, mesh / f"{name}.gz") if file.is_file()]


def mesh_file(mesh: Path, name: str) -> Path:
    """The file of this name, or its compressed form, in the folder of a mesh."""
    for file in (mesh / name, mesh / f"{name}.gz"):
        if file.is_file():
            return file
    raise FormatError(f"{mesh} has no file {name}; expected a mesh with {', '.join(_FILES)}")


def case_files(path: Path) -> list[Path]:
    """The files from which a case is read."""
    dictionary = dictionary_of(path)
    return ([dictionary] if dictionary else []) + mesh_files(path)


@contextmanager
def replaced_mesh(foam: Path) -> Iterator[Path]:
    """Yield a new folder for the files of a mesh; they replace those of the case if the block succeeds.

    The points are removed first and put in place last, so that a killed run leaves the old mesh or none. The case gets
    its ``.foam`` file and, if it has none, a ``system/controlDict``, which OpenFOAM's tools and ParaView require.
    """
    folder = followed(foam.parent)
    if not folder.is_dir() and not folder.parent.is_dir():
        raise FormatError(f"cannot write {foam}: the folder {folder.parent} does not exist; create it first")
    mesh = folder / POLY_MESH
    found = [name for name in _DEPENDENT for entry in (name, f"{name}.gz") if (mesh / entry).exists()]
    if found:
        raise FormatError(
            f"cannot write {mesh}: it has {', '.join(found)} of another mesh, which would not fit the new one; remove "
            "them first"
        )
    try:
        mesh.mkdir(parents=True, exist_ok=True)
        new = partial_path(mesh / "mesh")
        new.mkdir()
        with interruption.cleaned_up(lambda: shutil.rmtree(new, ignore_errors=True)):
            yield new
            interruption.check()
            for old in mesh_files(foam):
                old.unlink()
            for file in sorted(new.iterdir(), key=lambda file: file.name.startswith("points")):
                os.replace(file, mesh / file.name)
            control = foam.parent / "system" / "controlDict"
            if not control.exists():
                control.parent.mkdir(exist_ok=True)
                control.write_text(_CONTROL, encoding="ascii")
            foam.touch()
    except OSError as error:
        raise FormatError(f"cannot write {foam}: {reason_of(error)}") from error
