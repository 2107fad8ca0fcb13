"""Fields of cells and nodes in files: those computed, and those that the format of an output cannot hold."""

import dataclasses

import numpy as np
import pytest
import vtk_witness
from grids import frame, polar

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import Field, Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields
from meshdeform_formats import fields
from meshdeform_formats.fields import WITH_FIELDS, check_fields, with_fields
from meshdeform_formats.grids import FORMATS, complete_for_export, read_grid, write_grid


def moved(grid: Grid) -> CellFields:
    after = grid.moved(grid.points + 0.03 * np.sin(3 * grid.points[:, [1, 2, 0]]))
    return CellFields(after, find_topology(grid), grid)


def test_vtk_reads_them(tmp_path):
    cells = moved(polar())
    write_grid(with_fields(cells, ["all"]), tmp_path / "polar.vts")
    points, arrays = vtk_witness.read(tmp_path / "polar.vts")
    np.testing.assert_array_equal(arrays["node", "displacement"], points - polar().block(0))
    for name in CELL_MEASURES:
        if name != "displacement":
            expected = cells.values(name, 0, cells.whole(0)).astype(np.float32)
            np.testing.assert_array_equal(arrays["cell", name], expected, err_msg=name)
    assert not arrays["cell", "invalid"].any()


def test_values_do_not_depend_on_how_many_layers_are_measured_at_a_time(monkeypatch):
    """Of the neighbours of a layer as well."""
    cells = moved(frame(5, 3))
    expected = with_fields(cells, ["all"]).fields
    monkeypatch.setattr(fields, "_CELLS", 1)
    for one, other in zip(expected, with_fields(cells, ["all"]).fields, strict=True):
        assert (one.name, one.block) == (other.name, other.block)
        np.testing.assert_array_equal(one.values, other.values, err_msg=one.name)
    assert {field.name for field in expected} >= {"displacement", "growth_ratio", "interface_kink_deg", "invalid"}


def test_invalid_cells_are_marked(tmp_path):
    grid = frame()
    points = grid.points.copy()
    inside = int(grid.offsets[3]) + np.ravel_multi_index((2, 2, 1), grid.shapes[3])
    points[inside] += [1.5, 0.0, 0.0]
    cells = CellFields(grid.moved(points), find_topology(grid), grid)
    write_grid(with_fields(cells, ["invalid"]), tmp_path / "frame.vtm")
    _, arrays = vtk_witness.read(tmp_path / "frame" / "frame_3.vts")
    marked = np.argwhere(arrays["cell", "invalid"])
    assert len(marked) > 0
    # Only cells that have the node are.
    assert ((marked >= (1, 1, 0)) & (marked <= (2, 2, 1))).all()


def test_fields_of_the_same_name_are_replaced_and_others_stay():
    grid = frame()
    # Without a reference there is nothing to compare with.
    names = {field.name for field in with_fields(CellFields(grid, find_topology(grid)), ["all"]).fields}
    assert "aspect_ratio" in names
    assert not names & {name for name, measure in CELL_MEASURES.items() if measure.from_reference}
    old = [Field(name, "cell", b, np.zeros(grid.cell_shapes[b])) for name in ("f_skew", "T") for b in range(8)]
    dressed = with_fields(CellFields(dataclasses.replace(grid, fields=tuple(old)), find_topology(grid)), ["f_skew"])
    assert sorted({field.name for field in dressed.fields}) == ["T", "f_skew"]
    assert len(dressed.fields) == 16
    np.testing.assert_array_equal([field.values.max() for field in dressed.fields if field.name == "f_skew"], 1.0)


def test_refusals(tmp_path):
    with pytest.raises(CaseError, match="did you mean 'displacement'"):
        check_fields(["displacment"], tmp_path / "a.vtm", True)
    with pytest.raises(CaseError, match="give --reference"):
        check_fields(["volume_ratio"], tmp_path / "a.vtm", False)
    with pytest.raises(FormatError, match=r"\.xyz files cannot hold fields"):
        check_fields(["f_skew"], tmp_path / "a.xyz", True)
    for suffix in WITH_FIELDS:
        check_fields(["all", "f_skew"], tmp_path / f"a{suffix}", False)


ALL = [*(entry.suffixes[0] for entry in FORMATS.values()), ".su2", ".msh", ".inp"]
KEPT = {"iblank": (".xyz", ".cgns", ".vtk", ".vtu"), "pressure": (".cgns", ".vtk", ".vtu"), "some": (".cgns", ".vtk"),
        "flux": (".cgns", ".vtk")}  # fmt: skip


def of_all_kinds() -> Grid:
    grid = frame(3, 2)
    blocks = range(grid.n_blocks)
    fields = [Field("iblank", "node", b, np.ones(grid.shapes[b], dtype=np.int32)) for b in blocks]
    fields += [Field("pressure", "cell", b, np.ones(grid.cell_shapes[b])) for b in blocks]
    fields += [Field("some", "node", 2, np.ones(grid.shapes[2]))]
    fields += [Field("flux", "iface", b, np.ones((grid.shapes[b][0], *grid.cell_shapes[b][1:]))) for b in blocks]
    return dataclasses.replace(grid, fields=tuple(fields))


@pytest.mark.parametrize("suffix", ALL)
def test_fields_that_are_lost_are_named(suffix, tmp_path):
    notes = complete_for_export(of_all_kinds(), tmp_path / f"a{suffix}").notes
    lost = [name.upper() if name == "iblank" else name for name, kept in KEPT.items() if suffix not in kept]
    said = f"{suffix} files cannot hold these data of the grid, which are not written: {', '.join(lost)}"
    assert notes == ((said,) if lost else ())
    assert complete_for_export(frame(3, 2), tmp_path / f"a{suffix}").notes == ()


def test_solutions_of_a_cgns_file_are_lost_in_others(tmp_path):
    write_grid(of_all_kinds(), tmp_path / "a.cgns")
    grid = read_grid(tmp_path / "a.cgns")
    (note,) = set(complete_for_export(grid, tmp_path / "b.vtm").notes) - set(grid.notes)
    assert note.endswith("not written: FlowSolutionVertex, FlowSolutionCellCenter, FlowSolutionIFaceCenter")
    assert complete_for_export(grid, tmp_path / "b.cgns") is grid
