"""The public grid object."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core import grid as core
from meshdeform_core.errors import GridError
from meshdeform_core.grid import FloatArray
from meshdeform_core.parallel import Part, held_together, require_whole

from ..gate import checked_array, in_parts
from ..notebook import html_table

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
        arrays = [_checked_block(block, name) for block, name in zip(blocks, labels, strict=True)]
        if len({array.ndim for array in arrays}) > 1:
            raise GridError("plane (ni, nj, 2) and spatial (ni, nj, nk, 3) blocks are mixed; expected one kind")
        self._plane = bool(arrays) and arrays[0].ndim == 3
        self._core = core.Grid.from_blocks([_spatial(array) for array in arrays], labels)

    @classmethod
    def _of(cls, grid: core.Grid, plane: bool = False) -> Grid:
        """Wrap a grid of the core; ``plane`` if the user gave its blocks as (ni, nj, 2)."""
        self = cls.__new__(cls)
        self._core, self._plane = grid, plane
        return self

    @property
    def blocks(self) -> list[FloatArray]:
        """Read-only views of the blocks' coordinates: (ni, nj, nk, 3), or (ni, nj, 2) if given in that form.

        Raises
        ------
        GridError
            When every rank holds a :attr:`part` of the grid.
        """
        whole = self._whole("all blocks")
        views = [whole.block(b)[:, :, 0, :2] if self._plane else whole.block(b) for b in range(len(self))]
        return [_read_only(view) for view in views]

    @property
    def part(self) -> list[BlockPart]:
        """The nodes of this rank if ``prepare(..., comm=comm, parts=True)`` has distributed the grid; else all blocks.

        Ranks hold consecutive ranges of planes i, block after block, with about equally many nodes.
        """
        core, found = self._core, []
        for number in range(len(self)):
            planes = core.planes(number)
            if planes.start < planes.stop:
                points = _read_only(self._rows(number, core.points))
                found.append(BlockPart(number, planes.start, planes.stop, points))
        return found

    def _rows(self, number: int, values: FloatArray) -> FloatArray:
        """View of the rows of ``values`` (n_nodes, 3) that this rank holds of a block, in the form of its blocks."""
        view = self._core.in_planes(number, values)
        return view[:, :, 0, :2] if self._plane else view

    def _parted(self, values: FloatArray) -> list[FloatArray]:
        """The rows of ``values`` (n_nodes, 3) that this rank holds: one array per :attr:`part`."""
        return [self._rows(part.block, values).copy() for part in self.part]

    def _whole(self, what: str) -> core.Grid:
        """The grid, unless it is in parts: ``what`` takes the whole of it."""
        with in_parts():
            require_whole(self._core.points, what)
        return self._core

    def _divided_like(self, other: Grid) -> bool:
        """Whether the ranks hold the same parts of both grids, or the whole of both."""
        one, two = self._core.points, other._core.points
        if isinstance(one, Part) and isinstance(two, Part):
            return np.array_equal(one.bounds, two.bounds)
        return isinstance(one, Part) == isinstance(two, Part)

    @contextmanager
    def _together(self) -> Iterator[None]:
        """Context of work by all ranks that hold parts of the grid."""
        with in_parts(), held_together(self._core.points):
            yield

    def gathered(self, *, first_only: bool = False) -> Grid:
        """The whole grid from the parts of all ranks, which must all call this; the grid itself if it is not in parts.

        Parameters
        ----------
        first_only : only the first rank gets the whole grid, the others this one
        """
        points = self._core.points
        if not isinstance(points, Part) or points.ranks.count == 1:
            return self
        if not first_only:
            whole = points.ranks.collect(points.own, np.diff(points.bounds).tolist())
        else:
            first = points.ranks.number == 0
            whole = np.empty(points.shape) if first else points.own
            sources = range(1, points.ranks.count) if first else ()
            bounds = points.bounds.tolist()
            points.ranks.swap({} if first else {0: points.own}, {n: whole[bounds[n] : bounds[n + 1]] for n in sources})
            if not first:
                return self
            whole[: bounds[1]] = points.own
        return Grid._of(self._core.moved(whole), self._plane)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the blocks."""
        return self._core.names

    @property
    def shapes(self) -> tuple[tuple[int, int, int], ...]:
        """Nodes (ni, nj, nk) of each block; one along the missing index of a 2-D grid."""
        return self._core.shapes

    @property
    def patches(self) -> tuple[str, ...]:
        """Names of the patches and families that the file declares; block faces can be selected as well."""
        patches = self._core.patches
        return tuple(dict.fromkeys(name for patch in patches for name in (patch.name, patch.family) if name))

    @property
    def n_nodes(self) -> int:
        """Nodes of all blocks; coincident nodes count once per block."""
        return self._core.n_nodes

    @property
    def n_cells(self) -> int:
        """Cells of all blocks."""
        return self._core.n_cells

    @property
    def dimension(self) -> int:
        """2 if every block is one plane of nodes, else 3."""
        return self._core.dimension

    @property
    def path(self) -> Path | None:
        """The file that the grid was read from."""
        return self._core.path

    @property
    def format(self) -> str | None:
        """Format and variant of that file, in words."""
        return self._core.format.label if self._core.format else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the reader."""
        return self._core.notes

    def plot(
        self, metric: str = "f_skew", *, reference: Grid | None = None, plane: str | None = None,
        block: Sequence[str] = (), select: Sequence[str] = (), view: str = "auto",
        zoom: str | tuple[float, float, float, float] | None = None, before: str | None = None, arrows: bool = False,
        limits: tuple[float, float] | None = None, log: bool = False, lines: bool = True, title: str | None = None,
    ) -> Figure:  # fmt: skip
        """A picture of the grid, as ``meshdeform plot`` draws it; the arguments are that command's options.

        Parameters
        ----------
        metric : what colours the cells, like ``"volume_ratio"``
        reference : the undeformed grid, for measures that compare, ``before`` and ``arrows``
        plane : of nodes, like ``"k=1"`` or ``"j=mid"``, or in space, like ``"z=0.25"``
        block, select : patterns of blocks, of patches or block faces
        view : ``"auto"``, ``"x"``, ``"y"``, ``"z"``, ``"iso"`` or a direction like ``"1,-1,0.5"``
        zoom : ``"worst"``, ``"walls"`` or a window (left, right, bottom, top)
        before : ``"side"`` or ``"overlay"``: draw the reference too
        limits : ends of the colours

        Returns
        -------
        matplotlib.figure.Figure
            Shown by notebooks; ``savefig`` writes it.

        Raises
        ------
        CaseError
            When an argument is not understood, or there is nothing to draw.
        """
        from .pictures import PlotOptions, plot

        options = PlotOptions(
            metric=metric, plane=plane, block=tuple(block), select=tuple(select), view=view, zoom=zoom, before=before,
            arrows=arrows, limits=limits, log=log, lines=lines,
        )  # fmt: skip
        other = None if reference is None else reference._whole("a picture")
        return plot(self._whole("a picture"), other, title, options)

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
        from .pictures import pyvista_blocks

        other = None if reference is None else reference._whole("a pyvista grid")
        return pyvista_blocks(self._whole("a pyvista grid"), other, measures)

    def to_meshio(self) -> meshio.Mesh:
        """Unstructured hexahedra (2-D: quadrilaterals) with coincident nodes merged, and the fields of the file."""
        from meshdeform_formats.unstructured import as_mesh

        return as_mesh(self._whole("an unstructured grid"))

    def __len__(self) -> int:
        """Number of blocks."""
        return self._core.n_blocks

    def __eq__(self, other: object) -> bool:
        """The same blocks with the same names and coordinates."""
        if not isinstance(other, Grid):
            return NotImplemented
        one, two = self._core, other._core
        same = one.shapes == two.shapes and one.names == two.names and self._plane == other._plane
        return same and np.array_equal(self._whole("a comparison").points, other._whole("a comparison").points)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        where = f", {self.path.name!r}" if self.path else ""
        return (
            f"Grid({len(self)} {'block' if len(self) == 1 else 'blocks'}, {self.n_nodes:,} nodes, "
            f"{self.n_cells:,} cells, {self.dimension}-D{where})"
        )

    def _repr_html_(self) -> str:
        shown = zip(self.names[:12], self.shapes, strict=False)
        rows = [(name, " × ".join(map(str, shape))) for name, shape in shown]
        more = [(f"and {len(self) - 12} more", "")] if len(self) > 12 else []
        return html_table(repr(self), [*rows, *more], ("block", "nodes"))


def _checked_block(block: Any, name: str) -> FloatArray:
    plane = np.ndim(block) == 3
    shape, meaning = ((None, None, 2), "(x, y) of plane blocks") if plane else ((None, None, None, 3), "(x, y, z)")
    return checked_array(block, shape, f"block {name!r}", f"{meaning} by index, or (ni, nj, 2) in a plane", GridError)


def _spatial(block: FloatArray) -> FloatArray:
    if block.ndim == 4:
        return block
    spatial = np.zeros((*block.shape[:2], 1, 3))
    spatial[:, :, 0, :2] = block
    return spatial


def _read_only(view: FloatArray) -> FloatArray:
    view = view.view()
    view.flags.writeable = False
    return view
