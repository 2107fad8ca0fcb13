"""Grids whose components are in separate files."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from meshdeform_core.errors import CaseError, GridError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.components import with_components

from .case import CaseFile
from .grids import read_grid_with_boundaries

_WITHOUT_TREE = ("plot3d", "vtk")
"""Formats whose files hold nothing beyond the grid, so that they can be written without a copy of the original."""


def grid_of_case(grid: Grid, case: CaseFile) -> Grid:
    """The grid with the components of a case: those in separate files come last, as ``NAME.BLOCK``.

    Raises CaseError or FormatError or GridError when a file cannot be read, the dimensions differ, or components do not
    fit the blocks.
    """
    others = {
        name: read_grid_with_boundaries(file.path, file.boundary_file) for name, file in case.component_files.items()
    }
    return with_components(join(grid, others) if others else grid, case.case.components)


def join(grid: Grid, others: Mapping[str, Grid]) -> Grid:
    """One grid with the blocks of several; those of ``others`` are called ``NAME.BLOCK``."""
    grids = [grid, *others.values()]
    for name, other in others.items():
        if other.dimension != grid.dimension:
            raise CaseError(
                f"grid.components: {name!r} ({other.path}) is {other.dimension}-D, the grid ({grid.path}) "
                f"{grid.dimension}-D; expected the same"
            )
    names = [*grid.names, *(f"{name}.{block}" for name, other in others.items() for block in other.names)]
    if len(set(names)) < len(names):
        raise GridError(f"blocks of {', '.join(others)} have the names of others; rename these components")
    first = [sum(each.n_blocks for each in grids[:n]) for n in range(len(grids))]
    # The common format, if its files can be written without a copy of an original.
    form = grids[0].format
    if form is None or form.name not in _WITHOUT_TREE or any(each.format != form for each in grids):
        form = None
    notes = [note for each in grids for note in each.notes]
    if form is None and any(each.format and each.format.name not in _WITHOUT_TREE for each in grids):
        notes.append(
            "components of several files are written as one new file: blocks, boundaries, connections and fields are "
            "kept, other data of these files are not"
        )
    return Grid.from_blocks(
        [each.block(b) for each in grids for b in range(each.n_blocks)],
        names,
        patches=tuple(
            dataclasses.replace(p, windows=tuple(dataclasses.replace(w, block=w.block + start) for w in p.windows))
            for each, start in zip(grids, first, strict=True)
            for p in each.patches
        ),
        connections=tuple(
            dataclasses.replace(c, block=c.block + start, donor_block=c.donor_block + start)
            for each, start in zip(grids, first, strict=True)
            for c in each.connections
        ),
        fields=tuple(
            dataclasses.replace(field, block=field.block + start)
            for each, start in zip(grids, first, strict=True)
            for field in each.fields
        ),
        format=form,
        path=grid.path,
        overset=any(each.overset for each in grids),
        notes=tuple(notes),
    )
