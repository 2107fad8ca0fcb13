"""The public grid object, its files and pictures; checks of grids and arrays where they enter, below none."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core import grid as core
from meshdeform_core.boundary.motions.motion import LARGEST
from meshdeform_core.errors import FormatError, GridError, MeshDeformError, MotionError
from meshdeform_core.grid import FloatArray
from meshdeform_core.parallel import ONE_PROCESS, Ranks, WholeGridNeeded, sharing
from meshdeform_core.wording import counted

if TYPE_CHECKING:
    import meshio
    import pyvista
    from matplotlib.figure import Figure


class BlockPart(NamedTuple):
    """Coordinates ``points`` (last - first, nj, nk, 3) of the planes first <= i < last of a block, counted from 0."""

    block: int
    first: int
    last: int
    points: FloatArray


class Grid:
    """A block-structured grid.

    Parameters
    ----------
    blocks : coordinates of each block, (ni, nj, nk, 3) or, for plane grids, (ni, nj, 2); any real type, copied
        (grid length unit)
    names : of the blocks; ``block1``, ``block2``, ... by default

    Raises
    ------
    GridError
        When a block is not an array of finite numbers with such a shape, when plane and spatial blocks are mixed, or
        when names are missing or repeated.
    """

    def __init__(self, blocks: Sequence[ArrayLike], names: Sequence[str] | None = None):
        if isinstance(blocks, np.ndarray):
            raise GridError(f"blocks is one array {blocks.shape}; expected a sequence of arrays, like [block]")
        if not isinstance(blocks, Sequence) or isinstance(blocks, str):
            raise GridError(f"blocks is a {type(blocks).__name__}; expected a sequence of arrays, like [block]")
        if isinstance(names, str) or not all(isinstance(name, str) and name for name in names or ()):
            raise GridError(f"names = {names!r}; expected one string per block, like ['upper', 'lower']")
        labels = [f"block{n}" for n in range(1, len(blocks) + 1)] if names is None else list(names)
        if len(labels) != len(blocks):
            raise GridError(f"{len(labels)} names for {len(blocks)} blocks; expected one each")
        arrays = []
        for block, name in zip(blocks, labels, strict=True):
            plane = np.ndim(block) == 3
            shape, meaning = ((None, None, 2), "(x, y)") if plane else ((None, None, None, 3), "(x, y, z)")
            meaning += f"{' of plane blocks' if plane else ''} by index, or (ni, nj, 2) in a plane"
            arrays.append(checked_array(block, shape, f"block {name!r}", meaning, GridError))
        if len({array.ndim for array in arrays}) > 1:
            raise GridError("plane (ni, nj, 2) and spatial (ni, nj, nk, 3) blocks are mixed; expected one kind")
        self.plane = bool(arrays) and arrays[0].ndim == 3
        if self.plane:
            arrays = [np.pad(array[:, :, None], ((0, 0), (0, 0), (0, 0), (0, 1))) for array in arrays]
        self.core = core.Grid.from_blocks(arrays, labels)

    @property
    def blocks(self) -> list[FloatArray]:
        """Read-only views of the blocks' coordinates: (ni, nj, nk, 3), or (ni, nj, 2) if given in that form.

        Raises
        ------
        GridError
            When every rank holds a :attr:`part` of the grid.
        """
        grid = whole(self, "all blocks")
        views = [grid.block(b)[:, :, 0, :2] if self.plane else grid.block(b) for b in range(len(self))]
        return [read_only(view) for view in views]

    @property
    def part(self) -> list[BlockPart]:
        """The nodes of this rank if ``prepare(..., comm=comm)`` has distributed the grid; else all blocks.

        Ranks hold consecutive ranges of planes i, block after block, with about equally many nodes.
        """
        core, found = self.core, []
        for number in range(len(self)):
            planes = core.planes(number)
            if planes.start < planes.stop:
                points = read_only(rows_of_block(self, number, core.points))
                found.append(BlockPart(number, planes.start, planes.stop, points))
        return found

    def gathered(self) -> Grid:
        """The whole grid from the parts of all ranks, which all call this; the grid itself if it is not in parts."""
        points = self.core.nodes
        if not points.divided:
            return self
        return wrapped(self.core.moved(points.ranks.collect(points.own, np.diff(points.bounds).tolist())), self.plane)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the blocks."""
        return self.core.names

    @property
    def shapes(self) -> tuple[tuple[int, int, int], ...]:
        """Nodes (ni, nj, nk) of each block; one along the missing index of a 2-D grid."""
        return self.core.shapes

    @property
    def patches(self) -> tuple[str, ...]:
        """Names of the patches and families that the file declares; block faces can be selected as well."""
        patches = self.core.patches
        return tuple(dict.fromkeys(name for patch in patches for name in (patch.name, patch.family) if name))

    @property
    def n_nodes(self) -> int:
        """Nodes of all blocks; coincident nodes count once per block."""
        return self.core.n_nodes

    @property
    def n_cells(self) -> int:
        """Cells of all blocks."""
        return self.core.n_cells

    @property
    def dimension(self) -> int:
        """2 if every block is one plane of nodes, else 3."""
        return self.core.dimension

    @property
    def path(self) -> Path | None:
        """The file that the grid was read from."""
        return self.core.path

    @property
    def format(self) -> str | None:
        """Format and variant of that file, in words."""
        return self.core.format.label if self.core.format else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the reader."""
        return self.core.notes

    def plot(
        self, metric: str = "f_skew", *, reference: Grid | None = None, title: str | None = None, **options: Any
    ) -> Figure:
        """A picture of the grid, as ``meshdeform plot`` draws it; shown by notebooks, ``savefig`` writes it.

        Parameters
        ----------
        metric : what colours the cells, like ``"volume_ratio"``
        reference : the undeformed grid, for measures that compare
        options : those of the command: ``plane`` of nodes, like ``"k=1"``, or in space, like ``"z=0.25"``;
            ``select``, a list of patterns; ``view``; ``zoom`` (``"worst"``, ``"walls"`` or left, right, bottom, top);
            ``limits`` of the colours; ``log``

        Raises
        ------
        CaseError
            When an argument is not understood, or there is nothing to draw.
        """
        from meshdeform_formats.picture.overview import PlotOptions, picture
        from meshdeform_formats.picture.page import page_figure
        from meshdeform_formats.picture.subject import Subject

        chosen, name = PlotOptions(metric, **options), self.path.name if self.path else ""
        subject = Subject.of(*_compared(self, reference, "a picture"))
        return page_figure(picture(subject, chosen, name if title is None else title))

    def to_pyvista(self, *measures: str, reference: Grid | None = None) -> pyvista.MultiBlock:
        """The blocks as pyvista structured grids, by name, with the file's fields at nodes and cells.

        ``grid.to_pyvista("f_skew").plot(scalars="f_skew")`` opens a window to turn and cut the grid.

        Parameters
        ----------
        measures, reference : cell measures to add, and the undeformed grid for those that compare, as for :meth:`plot`

        Raises
        ------
        CaseError
            When a measure is unknown or not available for this grid.
        """
        import pyvista

        from meshdeform_core.quality.fields import CellFields

        cells, grid = CellFields.of(*_compared(self, reference, "a pyvista grid")), self.core
        blocks = pyvista.MultiBlock()
        for number, name in enumerate(grid.names):
            block = pyvista.StructuredGrid(*np.moveaxis(grid.block(number), 3, 0))
            for field in grid.fields:
                data = {"node": block.point_data, "cell": block.cell_data}.get(field.location)
                if field.block == number and data is not None:
                    # VTK counts the first index fastest; vectors have a trailing axis.
                    data[field.name] = field.values.reshape(-1, *field.values.shape[3:], order="F")
            for measure in measures:
                block.cell_data[measure] = cells.values(measure, number, cells.whole(number)).ravel(order="F")
            blocks.append(block, name)
        return blocks

    def to_meshio(self) -> meshio.Mesh:
        """Unstructured hexahedra (2-D: quadrilaterals) with coincident nodes merged, and the fields of the file."""
        from meshdeform_formats.unstructured import as_mesh

        return as_mesh(whole(self, "an unstructured grid"))

    def __len__(self) -> int:
        """Number of blocks."""
        return self.core.n_blocks

    def __eq__(self, other: object) -> bool:
        """The same blocks with the same names and coordinates."""
        if not isinstance(other, Grid):
            return NotImplemented
        one, two = self.core, other.core
        same = one.shapes == two.shapes and one.names == two.names and self.plane == other.plane
        return same and np.array_equal(whole(self, "a comparison").points, whole(other, "a comparison").points)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        where = f", {self.path.name!r}" if self.path else ""
        return (
            f"Grid({counted(len(self), 'block')}, {self.n_nodes:,} nodes, {self.n_cells:,} cells, "
            f"{self.dimension}-D{where})"
        )


def read_only(array: FloatArray) -> FloatArray:
    """A view of an array that refuses changes."""
    view = array.view()
    view.flags.writeable = False
    return view


def wrapped(grid: core.Grid, plane: bool = False) -> Grid:
    """A grid of the core as one of the library; ``plane`` if its blocks are given to users as (ni, nj, 2)."""
    own = Grid.__new__(Grid)
    own.core, own.plane = grid, plane
    return own


def whole(grid: Grid, what: str) -> core.Grid:
    """The grid of the core, of which ``what`` takes the whole, so that one in parts is refused."""
    with in_parts():
        grid.core.nodes.require_whole(what)
    return grid.core


def _compared(grid: Grid, reference: Grid | None, what: str) -> tuple[core.Grid, core.Grid | None]:
    return whole(grid, what), None if reference is None else whole(reference, what)


@contextmanager
def together(grid: Grid) -> Iterator[None]:
    """Context of work by all ranks that hold parts of the grid."""
    with in_parts(), sharing(threads=grid.core.nodes.ranks.cores):
        yield


def rows_of_block(grid: Grid, number: int, values: FloatArray) -> FloatArray:
    """View of the rows of ``values`` (n_nodes, 3) that this rank holds of a block, in the form of its blocks."""
    view = grid.core.in_planes(number, values)
    return view[:, :, 0, :2] if grid.plane else view


def by_part(grid: Grid, values: FloatArray) -> list[FloatArray]:
    """The rows of ``values`` (n_nodes, 3) that this rank holds: one array per ``grid.part``."""
    return [rows_of_block(grid, part.block, values).copy() for part in grid.part]


def read(path: str | Path, *, boundary_file: str | Path | None = None, **variant: str) -> Grid:
    """Read a block-structured grid: Plot3D, CGNS, VTK or a blockMeshDict of OpenFOAM, recognised by its content.

    Parameters
    ----------
    boundary_file : NASA neutral map file with the boundaries, for formats that hold none
    variant : how to read an ambiguous Plot3D file, like ``byte_order="big"`` (see docs/formats.md)

    Raises
    ------
    FormatError, GridError
        When the file is missing, damaged, ambiguous or not a block-structured grid.
    """
    from meshdeform_formats.grids import read_grid_with_boundaries

    boundaries = None if boundary_file is None else _path(boundary_file)
    return wrapped(read_grid_with_boundaries(_path(path), boundaries, variant))


def write(grid: Grid, path: str | Path, *, force: bool = False, **variant: str) -> None:
    """Write a grid; the suffix selects the format, and a folder (``case/``) is an OpenFOAM case.

    By default the variant is that of the file the grid was read from.
    The file is replaced as a whole or, if anything fails, left untouched.

    Parameters
    ----------
    grid : if it is in parts, all ranks call this together, and each writes its part
    force : overwrite an existing file; the file that the grid was read from is never overwritten
    variant : format variant, like ``encoding="ascii"`` (see docs/formats.md)

    Raises
    ------
    FormatError
        When the file exists, cannot be written, or the format has no such variant.
    """
    from meshdeform_formats.grids import complete_for_export, write_grid
    from meshdeform_formats.openfoam.case import output_path

    if not isinstance(grid, Grid):
        raise GridError(f"found a {type(grid).__name__}; expected a Grid to write")
    _path(path)
    target, own = output_path(path), grid.core
    if target.exists():
        if own.path is not None and own.path.exists() and target.samefile(own.path):
            raise FormatError(f"{target} is the file that the grid was read from; choose another name")
        if not force:
            raise FormatError(f"{target} exists; choose another name, or force=True to overwrite it")
    with together(grid):
        write_grid(complete_for_export(own, target, variant), target, variant)


def _path(path: object) -> Path:
    if not isinstance(path, str | Path):
        raise FormatError(f"file name {path!r} is a {type(path).__name__}; expected a string or a Path")
    if "\0" in str(path):
        raise FormatError(f"file name {str(path)!r} has a null character; expected the name of a file")
    return Path(path)


def user_grid(grid: object, ranks: Ranks = ONE_PROCESS) -> Grid:
    """The argument as a :class:`Grid`; a file name is read, in parts by several ranks, anything else refused."""
    if isinstance(grid, Grid):
        return grid
    if isinstance(grid, str | Path):
        from meshdeform_formats.grids import read_grid

        return wrapped(read_grid(_path(grid), ranks=ranks))
    hint = "; wrap coordinate arrays in Grid([block, ...])" if isinstance(grid, np.ndarray | Sequence | Mapping) else ""
    raise GridError(f"found a {type(grid).__name__}; expected a Grid or the name of a grid file{hint}")


@contextmanager
def in_parts() -> Iterator[None]:
    """Make the error of what a grid in parts does not allow a ``GridError``, on all ranks alike."""
    try:
        yield
    except WholeGridNeeded as reason:
        raise GridError(
            f"{reason}: that takes the whole grid on every rank, which holds a part; expected a grid prepared without "
            f"comm=, or gathered by Grid.gathered()"
        ) from None


def checked_array(
    values: ArrayLike, shape: Sequence[int | None], what: str, meaning: str, error: type[MeshDeformError]
) -> FloatArray:
    """``values`` as a new C-contiguous float64 array; ``shape`` has ``None`` where any extent is accepted.

    Refused is what is no array of real numbers of this shape, carries a unit, or has values that are not finite or too
    large for any grid; ``what`` and ``meaning`` are the name of the array and the meaning of its rows, for messages.
    """
    expected = f"expected ({', '.join('n' if n is None else str(n) for n in shape)}): {meaning}"
    # Arrays of other packages lose their unit by conversion.
    unit = getattr(values, "units", getattr(values, "unit", None))
    if unit is not None and not callable(unit) and str(unit):
        raise error(f"{what} has the unit {str(unit)!r}; expected plain numbers in the length unit of the grid")
    try:
        array = np.asanyarray(values)
    except ValueError as failure:
        raise error(f"{what} is not an array ({failure}); {expected}") from None
    if isinstance(array, np.ma.MaskedArray) and np.ma.is_masked(array):
        raise error(f"{what} has {int(np.ma.count_masked(array))} masked values; {expected}, none of them missing")
    if array.dtype.kind not in "iuf":
        raise error(f"{what} has the type {array.dtype}; expected real numbers, {expected[9:]}")
    fits = len(array.shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        raise error(f"{what} has the shape {array.shape}; {expected}")
    result: FloatArray = np.array(array, dtype=np.float64, order="C")
    finite = np.isfinite(result)
    if not finite.all():
        at = tuple(int(n) for n in np.argwhere(~finite)[0])
        raise error(
            f"{what} has {int((~finite).sum())} values that are not finite, the first is {result[at]} at index "
            f"{list(at)}; expected finite numbers"
        )
    largest = float(np.abs(result).max(initial=0.0))
    if largest > LARGEST:
        raise error(f"{what} has values up to {largest:.3g}; expected lengths up to {LARGEST:g}")
    return result


def checked_time(value: Any, error: type[MeshDeformError]) -> float:
    """A time, which has to be a finite number."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise error(f"time = {value!r}; expected a finite number")
    return float(value)


def whole_number(value: Any) -> Any:
    """An integer of any type, such as numpy's, as ``int``; anything else is returned unchanged."""
    return int(value) if isinstance(value, numbers.Integral) and not isinstance(value, bool) else value


def require_arguments(function: Callable[..., Any], what: str, *names: str) -> None:
    """Refuse a function that cannot be called with as many arguments as there are ``names``."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        # Some compiled functions have no signature.
        return
    try:
        signature.bind(*names)
    except TypeError:
        raise MotionError(f"{what} is a function{signature}; expected one of ({', '.join(names)})") from None
