"""A full disk is found before anything is computed."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import pytest
from grids import frame, frame_2d

from meshdeform_core.errors import FormatError
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.grids import variant_of
from meshdeform_formats.placing import bytes_at, least_bytes, require_space

VARIANTS = {
    "c.p3dbin": {"encoding": "binary"},
    "records.p3dbin": {},
    "small.p3dbin": {"precision": "float32"},
    "text.p3dfmt": {},
    "plane.p2dbin": {},
    "new.cgns": {},
    "single.cgns": {"precision": "float32"},
    "grid.vts": {},
    "packed.vts": {"compression": "zlib"},
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


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_no_copy_is_smaller_than_foretold(precision, tmp_path):
    write_grid(frame(), tmp_path / "grid.cgns")
    grid = read_grid(tmp_path / "grid.cgns")
    path, options = tmp_path / "copy.cgns", {"precision": precision}
    expected = least_bytes(grid, path, variant_of(grid, path, options))
    write_grid(grid, path, options)
    assert 0 < expected <= path.stat().st_size


def test_a_full_disk_is_refused_with_what_is_needed(tmp_path, monkeypatch):
    grid = frame()
    path = tmp_path / "missing" / "grid.p3dbin"
    variant = variant_of(grid, path, {})
    needed = least_bytes(grid, path, variant)
    asked = []
    for free in (needed, needed - 1):
        monkeypatch.setattr(shutil, "disk_usage", lambda at, free=free: asked.append(at) or SimpleNamespace(free=free))
        if free == needed:
            require_space(grid, path, variant)
        else:
            with pytest.raises(FormatError, match=r"has .* free, the grid takes at least .*another disk"):
                require_space(grid, path, variant)
    assert asked == [tmp_path, tmp_path]
