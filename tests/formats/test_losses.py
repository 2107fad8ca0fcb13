"""Data that the format of an output cannot hold are named, data that it keeps are not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from grids import frame

from meshdeform_core.grid import Field, Grid
from meshdeform_formats.grids import complete_for_export, read_grid, write_grid

ALL = (
    ".xyz", ".cgns", ".vtm", ".foam", ".su2", ".msh", ".inp", ".vtu", ".xdmf",
)  # fmt: skip
KEPT = {
    "iblank": (".xyz", ".cgns", ".vtm", ".vtu", ".xdmf"),
    "pressure": (".cgns", ".vtm", ".vtu", ".xdmf"),
    "some": (".cgns", ".vtm"),
    "flux": (".cgns", ".vtm"),
}


def with_fields() -> Grid:
    grid = frame(3, 2)
    blocks = range(grid.n_blocks)
    fields = [Field("iblank", "node", b, np.ones(grid.shapes[b], dtype=np.int32)) for b in blocks]
    fields += [Field("pressure", "cell", b, np.ones(grid.cell_shapes[b])) for b in blocks]
    fields += [Field("some", "node", 2, np.ones(grid.shapes[2]))]
    fields += [Field("flux", "iface", b, np.ones((grid.shapes[b][0], *grid.cell_shapes[b][1:]))) for b in blocks]
    return dataclasses.replace(grid, fields=tuple(fields))


@pytest.mark.parametrize("suffix", ALL)
def test_fields_that_are_lost_are_named(suffix, tmp_path):
    notes = complete_for_export(with_fields(), tmp_path / f"a{suffix}").notes
    lost = [name.upper() if name == "iblank" else name for name, kept in KEPT.items() if suffix not in kept]
    said = f"{suffix} files cannot hold these data of the grid, which are not written: {', '.join(lost)}"
    assert notes == ((said,) if lost else ())


def test_a_grid_without_fields_loses_nothing(tmp_path):
    for suffix in ALL:
        assert complete_for_export(frame(3, 2), tmp_path / f"a{suffix}").notes == ()


def test_solutions_of_a_cgns_file_are_lost_in_others(tmp_path):
    write_grid(with_fields(), tmp_path / "a.cgns")
    grid = read_grid(tmp_path / "a.cgns")
    (note,) = set(complete_for_export(grid, tmp_path / "b.vtm").notes) - set(grid.notes)
    assert note.endswith("not written: FlowSolutionVertex, FlowSolutionCellCenter, FlowSolutionIFaceCenter")
    assert complete_for_export(grid, tmp_path / "b.cgns").notes == grid.notes
