"""A full disk is found before anything is computed."""

from __future__ import annotations

import pytest
from grids import frame, frame_2d

from meshdeform_formats import write_grid
from meshdeform_formats.grids import variant_of
from meshdeform_formats.placing import bytes_at, least_bytes

VARIANTS = {
    "c.p3dbin": {"encoding": "binary"},
    "records.p3dbin": {},
    "small.p3dbin": {"precision": "float32"},
    "text.p3dfmt": {},
    "plane.p2dbin": {},
    "new.cgns": {},
    "single.cgns": {"precision": "float32"},
    "grid.vts": {},
    "text.vts": {"encoding": "ascii"},
    "single.vts": {"precision": "float32"},
    "plane.vtk": {},
    "blocks.vtm": {},
}


@pytest.mark.parametrize("name", VARIANTS)
def test_no_file_is_smaller_than_foretold(name, tmp_path):
    grid = frame_2d() if name.startswith("plane") else frame()
    if name.endswith((".vts", ".vtk")):
        grid = type(grid).from_blocks([grid.block(0)])
    path = tmp_path / name
    variant = variant_of(grid, path, VARIANTS[name])
    expected = least_bytes(grid, path, variant)
    write_grid(grid, path, VARIANTS[name])
    size = bytes_at(path)
    if name.startswith(("text", "packed")):
        assert expected == 0
    else:
        assert 0.9 * expected < expected <= size
        assert expected > 0.5 * size or path.suffix in (".cgns", ".vtm", ".vts", ".vtk")
