"""Case files to start from: they name every boundary, and they run."""

import os
from pathlib import Path

import pytest

GRIDS = Path(os.environ.get("MESHDEFORM_GRIDS", "../shared/grids")).resolve()
REAL = [
    ("717_wl_L2.cgns", None), ("nak_a_141.cgns", None), ("nak_a_141.p3dfmt", None),
    ("nak_a_141.p3dfmt", "nak_a_141.nmf"), ("backstep5_4levdn.p3dbin", None),
    ("backstep5_4levdn.p3dbin", "backstep5_4levdn.nmf"), ("cylinder_ring_4blk.x", None), ("StructuredGrid.vts", None),
    ("SampleStructGrid.vtk", None), ("shear_3blk_2d.p2dfmt", None), ("shear_3blk_2d.p2dfmt", "shear_3blk.nmf"),
]  # fmt: skip


def test_a_case_for_a_grid_with_patches(bench, call):
    result = call("init", "grid.cgns", "-o", "new.toml")
    assert (result.code, result.err) == (0, "")
    assert "meshdeform deform grid.cgns -c new.toml --dry-run" in result.out
    plan = call("deform", "grid.cgns", "-c", "new.toml", "--dry-run")
    # The motion of the template is still to be filled in.
    assert (plan.code, plan.err.count("\n")) == (0, 1)
    assert "warning: nothing moves: the displacement is zero everywhere; check --time" in plan.err
    assert "not selected" not in plan.out
    call("convert", "grid.cgns", "new.xyz")
    Path("cases").mkdir()
    files = ("--boundary-file", "new.nmf", "--table", "table.csv", "-o", "cases/new.toml")
    assert "cases/new.toml: check the boundaries, then" in call("init", "new.xyz", *files).out
    assert all(f'"../{name}"' in Path("cases/new.toml").read_text() for name in ("new.nmf", "table.csv"))
    assert call("deform", "new.xyz", "-c", "cases/new.toml", "--dry-run").code == 0


@pytest.mark.parametrize(("name", "boundaries"), REAL)
def test_cases_for_real_grids_run(name, boundaries, tmp_path, monkeypatch, call):
    if not (GRIDS / name).exists():
        pytest.skip(f"{GRIDS / name} is absent (MESHDEFORM_GRIDS)")
    monkeypatch.chdir(tmp_path)
    more = ("--boundary-file", GRIDS / boundaries) if boundaries else ()
    assert call("init", GRIDS / name, *more, "-o", "case.toml").code == 0
    assert not boundaries or f'"{GRIDS / boundaries}"' in Path("case.toml").read_text()
    result = call("deform", GRIDS / name, "-c", "case.toml", "--dry-run")
    if "# No wall was found." in Path("case.toml").read_text():
        assert "no node moves" in result.err
        return
    assert result.code == 0, result.err
    assert "not selected" not in result.out
