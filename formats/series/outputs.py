"""The files of a series: one grid file per level with an index for ParaView, or an OpenFOAM case.

======================  ========================  ==============================================
levels                  index                     read by
======================  ========================  ==============================================
``.vts .vtm .vtu``      ``NAME.pvd``              ParaView's collection reader
``.vtk .cgns``          ``NAME.vtk.series`` ...   ParaView's file series readers (5.5 and later)
Plot3D                  ``NAME.series.p3d``       VTK's Plot3D meta file reader
======================  ========================  ==============================================
"""

from __future__ import annotations

import abc
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, FloatArray, Grid
from meshdeform_core.velocity import FLUX, SWEPT

from ..fields import WITH_FIELDS
from ..files import invalid_path, remove_partial, replacing
from ..grids import FORMATS, format_of, read_grid, variant_of, write_grid
from ..inputs import bytes_at, least_bytes, velocity_bytes
from ..openfoam.case import POLY_MESH, mesh_files, replaced_mesh
from ..openfoam.format import MeshWriter
from ..plot3d.variant import Variant

VELOCITY = "GridVelocity"
_WITH_FACES = (*FORMATS["vtk"].suffixes, *FORMATS["cgns"].suffixes)
_COLLECTION = (".vts", ".vtm", ".vtu")
_LONGEST = 17
_SERIES = (".vtk", *FORMATS["cgns"].suffixes)


@dataclass(eq=False)
class SeriesFiles(abc.ABC):
    """The levels on disk. Every file is complete or absent, whenever the program is stopped.

    Attributes
    ----------
    name : of the file, or of the files of all levels, in ``folder``
    options : of the variant of the format
    velocity : how grid velocities are computed that the files hold; ``none``
    dress : adds fields to a level before it is written
    invalid : numbers of the levels that are kept under the name of an invalid grid
    view : the file to open in ParaView
    """

    grid: Grid
    folder: Path
    name: str
    times: tuple[float, ...]
    options: Mapping[str, Any]
    velocity: str

    def __post_init__(self) -> None:
        self.plain = self.folder / self.name
        self.view: Path | None = None
        self.dress: Callable[[Grid], Grid] = lambda level: level
        self.invalid: set[int] = set()
        self.variant = variant_of(self.grid, self.plain, self.options)

    @abc.abstractmethod
    def names(self, number: int) -> tuple[Path, Path]:
        """File or folder of a level if it is valid, and if it is invalid."""

    @abc.abstractmethod
    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        """Write one level, with the grid velocity (n_nodes, 3) and fields at the cell faces; on all ranks."""

    @abc.abstractmethod
    def read(self, number: int) -> FloatArray:
        """Coordinates (n_nodes, 3) of a written level, in the order of the series' grid."""

    def stored(self, path: Path) -> Path:
        """The file with the coordinates of a level whose file or folder is ``path``."""
        return path

    def path(self, number: int) -> Path:
        """The file or folder that holds a level when the series is complete."""
        return self.names(number)[number in self.invalid]

    @property
    def outputs(self) -> list[Path]:
        """All files of the complete series."""
        return [*map(self.file, range(len(self.times))), *([self.view] if self.view else [])]

    @property
    def replaced(self) -> list[Path]:
        """All files that may be written or removed, for checks before anything is computed."""
        both = [self.stored(path) for number in range(len(self.times)) for path in self.names(number)]
        return [*both, *([self.view] if self.view else [])]

    @property
    def readable(self) -> bool:
        """Whether levels can be read back."""
        return True

    def file(self, number: int) -> Path:
        """The file with the coordinates of a level."""
        return self.stored(self.path(number))

    def has(self, number: int) -> bool:
        """Whether a level has been written."""
        return self.file(number).is_file()

    def recall(self, records: Sequence[Mapping[str, Any]]) -> None:
        """Take over the names of levels that an earlier run has written, from their records in the report."""
        self.invalid = {n for n, record in enumerate(records) if record["file"] == self.names(n)[1].name}

    def least_bytes(self, first: int) -> int:
        """Smallest space on the disk that the levels from number ``first`` on take in addition to files that they
        replace; 0 for text and compressed files, whose size is not known."""
        return 0

    def publish(self, done: int) -> None:  # noqa: B027 (not every format has an index)
        """Make the first ``done`` levels visible to other programs; on all ranks."""

    def clean(self) -> None:
        """Remove remains of a killed run."""
        remove_partial(self.folder)


def with_velocity(grid: Grid, velocity: FloatArray | None, faces: Sequence[Field], precision: str) -> Grid:
    """The grid with the velocity (n_nodes, 3) as a vector field at its nodes and the fields ``faces``.

    Existing fields of these names are replaced. Swept volumes keep double precision, as their sums nearly cancel.
    """
    if velocity is None:
        return grid
    own = (grid.in_planes(block, velocity).astype(precision, copy=False) for block in range(grid.n_blocks))
    new = [Field(VELOCITY, "node", b, grid.spread(each, grid.shapes[b][0])) for b, each in enumerate(own)]
    kept = (field for field in grid.fields if field.name not in (VELOCITY, SWEPT, FLUX))
    return dataclasses.replace(grid, fields=(*kept, *new, *faces))


class LevelFiles(SeriesFiles):
    """One grid file per level, ``NAME_0000.vtm`` ..., and an index of them for ParaView.

    Raises FormatError when velocities are requested but the format cannot hold them, or the variant cannot hold the
    grid.
    """

    def __post_init__(self) -> None:
        self.suffix = Path(self.name).suffix.lower()
        format_of(Path(self.name))
        swept = self.velocity == "swept"
        able = _WITH_FACES if swept else WITH_FIELDS
        if self.velocity != "none" and self.suffix not in able:
            raise FormatError(
                f"{self.suffix} files cannot hold {'values at cell faces' if swept else 'the grid velocity'}; choose "
                f"one of {' '.join(dict.fromkeys(able))}, or omit the velocity"
            )
        super().__post_init__()
        kinds = {_COLLECTION: ".pvd", _SERIES: f"{self.suffix}.series", FORMATS["plot3d"].suffixes: ".series.p3d"}
        index = [self.plain.with_suffix(end) for suffixes, end in kinds.items() if self.suffix in suffixes]
        self.view = index[0] if index else None

    def names(self, number: int) -> tuple[Path, Path]:
        digits = max(4, len(str(len(self.times) - 1)))
        plain = self.folder / f"{self.plain.stem}_{number:0{digits}d}{self.suffix}"
        return plain, invalid_path(plain)

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        def remove_other() -> None:
            # The level of an earlier run with the other verdict could be mistaken for this one.
            other = self.names(number)[number not in self.invalid]
            other.unlink(missing_ok=True)
            self._remove_lone_pieces(other)

        dressed = with_velocity(self.dress(grid), velocity, faces, self.variant.precision)
        write_grid(dressed, self.path(number), self.options)
        grid.nodes.ranks.on_first(remove_other)

    def read(self, number: int) -> FloatArray:
        path = self.path(number)
        if not self.readable:
            raise FormatError(
                f"cannot continue after {path}: the next level needs its coordinates, and {self.suffix} files cannot "
                f"be read; restart the series (--force), or use a format that can be read"
            )
        grid = read_grid(path, ranks=self.grid.nodes.ranks)
        if grid.n_nodes != self.grid.n_nodes:
            raise FormatError(f"{path} has {grid.n_nodes:,} nodes; a level of this series has {self.grid.n_nodes:,}")
        return grid.points

    @property
    def readable(self) -> bool:
        return hasattr(FORMATS[format_of(self.path(0))].load(), "read")

    def least_bytes(self, first: int) -> int:
        paths = [self.path(number) for number in range(first, len(self.times))]
        each = least_bytes(self.grid, self.path(first), self.variant) if paths else 0
        each += velocity_bytes(self.grid, self.velocity, self.variant.precision) if each else 0
        # A level is complete before it replaces another one.
        return max(each, len(paths) * each - sum(map(bytes_at, paths)))

    def publish(self, done: int) -> None:
        if self.view:
            levels = [(self.times[number], self.path(number).name) for number in range(done)]
            self.grid.nodes.ranks.on_first(partial(write_index, self.view, levels, self.variant))

    def clean(self) -> None:
        super().clean()
        for number in range(len(self.times)):
            for path in self.names(number):
                self._remove_lone_pieces(path)

    def _remove_lone_pieces(self, index: Path) -> None:
        """Remove remains of a multi-block set from a killed run, and the pieces of one whose index was removed."""
        if self.suffix != ".vtm":
            return
        from ..vtk.multiblock import clean

        clean(index)
        folder = index.with_suffix("")
        if folder.is_dir() and not index.exists():
            for piece in folder.glob(f"{index.stem}_*.vts"):
                piece.unlink()
            folder.rmdir()


class FoamFiles(SeriesFiles):
    """``NAME.foam``, ``constant/polyMesh`` and ``TIME/polyMesh/points``, as OpenFOAM's moving meshes have them.

    Levels with invalid cells are in ``TIME.invalid``, which OpenFOAM does not take for a time. OpenFOAM and ParaView
    find the times by their folders.

    Raises FormatError when velocities are requested, or two times cannot be told apart by their names.
    """

    def __post_init__(self) -> None:
        if self.velocity != "none":
            raise FormatError("OpenFOAM finds the grid velocity from the points; omit --velocity")
        # Names of the times with as few digits as possible, at least the six that OpenFOAM writes.
        found = ([f"{time:.{digits}g}" for time in self.times] for digits in range(6, _LONGEST + 1))
        self.time_names = next((names for names in found if len(set(names)) == len(names)), [])
        if not self.time_names:
            raise FormatError("two times of the series are equal; expected different ones")
        super().__post_init__()
        self.view, self._begun = self.plain, False

    @cached_property
    def _writer(self) -> MeshWriter:
        return MeshWriter(self.grid, self.variant)

    def names(self, number: int) -> tuple[Path, Path]:
        return self.folder / self.time_names[number], self.folder / f"{self.time_names[number]}.invalid"

    def stored(self, path: Path) -> Path:
        return path / "polyMesh" / "points"

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        grid.nodes.require_whole("levels are written for OpenFOAM")
        if not self._begun:
            with replaced_mesh(self.plain) as folder:
                self._writer.write(folder, self.grid)
            self._begun = True
        target = self.stored(self.path(number))
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as partial:
            self._writer.write_points(partial, grid, f"{self.time_names[number]}/polyMesh")
        # Remove the level of an earlier run with the other verdict, which could be mistaken for this one, and its
        # folder unless something else is in it.
        other = self.names(number)[number not in self.invalid]
        self.stored(other).unlink(missing_ok=True)
        for empty in (other / "polyMesh", other):
            if empty.is_dir() and not any(empty.iterdir()):
                empty.rmdir()

    def read(self, number: int) -> FloatArray:
        return self._writer.read_points(self.stored(self.path(number)))

    def has(self, number: int) -> bool:
        return super().has(number) and len(mesh_files(self.plain)) > 0

    def clean(self) -> None:
        super().clean()
        remove_partial(self.folder / POLY_MESH)
        for number in range(len(self.time_names)):
            for folder in self.names(number):
                remove_partial(folder / "polyMesh")


def write_index(path: Path, levels: Sequence[tuple[float, str]], variant: FileFormat) -> None:
    """Write the index of levels, given as time and file name in the same folder, replacing it as a whole.

    ``variant`` is that of the levels: Plot3D files do not declare how to read them.
    """
    if path.suffix == ".pvd":
        root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        collection = ElementTree.SubElement(root, "Collection")
        for time, name in levels:
            ElementTree.SubElement(collection, "DataSet", timestep=repr(time), group="", part="0", file=name)
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode", xml_declaration=True)
    elif path.suffix == ".p3d":
        names = [{"time": time, "xyz": name} for time, name in levels]
        plot3d = Variant.of(variant)
        text = json.dumps(
            {
                "auto-detect-format": False,
                "format": "ascii" if plot3d.encoding == "ascii" else "binary",
                "byte-order": plot3d.byte_order or "little",
                "precision": 32 if plot3d.precision == "float32" else 64,
                "multi-grid": plot3d.multiblock,
                "language": "fortran" if plot3d.encoding == "fortran" else "C",
                "blanking": plot3d.iblank,
                "2D": plot3d.dimension == 2,
                "filenames": names,
            },
            indent=1,
        )
    else:
        files = [{"name": name, "time": time} for time, name in levels]
        text = json.dumps({"file-series-version": "1.0", "files": files}, indent=1)
    with replacing(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")
