"""Real grids of other people: deformed as their owners would, converted to everything and back."""

import json
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.grid.topology import find_topology, quads_of_patches
from meshdeform_formats import read_grid

pytestmark = pytest.mark.slow

GRIDS = (
    "717_wl_L2.cgns", "717_wl_L2_hdf5.cgns", "nak_a_141.cgns", "nak_a_141.p3dfmt", "cylinder_ring_4blk.x",
    "backstep5_4levdn.p3dbin", "shear_3blk_2d.p2dfmt", "StructuredGrid.vts", "SampleStructGrid.vtk",
)  # fmt: skip

WING = """
[[boundary]]
name = "wing"
select = ["wall"]
kind = "moving"
motion = [{ rotate = { angle = 5, axis = [0, 0, 1], center = [0.25, 0, 0] } }]

[[boundary]]
name = "far"
select = ["Far"]
kind = "fixed"

[[boundary]]
name = "symmetry"
select = ["Sym"]
kind = "symmetry"
"""


def deformed(call, grid: Path, case: str, *options: str):
    """The grid before and after, and the report."""
    Path("case.toml").write_text(case)
    output = f"out{grid.suffix}"
    result = call("deform", grid, "-c", "case.toml", "-o", output, "--report", "report.json", "--force", *options)
    assert result.code == 0, result.err
    before, after = read_grid(grid), read_grid(output)
    topology = find_topology(before)
    copies, first = topology.face_nodes, topology.first[topology.number]
    # Copies that were one point to the last bit still are; the ring has some that were not.
    same = (before.points[copies] == before.points[first]).all(axis=1)
    assert same.mean() > 0.9
    np.testing.assert_array_equal(after.points[copies[same]], after.points[first[same]])
    return before, after, json.loads(Path("report.json").read_text())


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("container", ["717_wl_L2.cgns", "717_wl_L2_hdf5.cgns"])
def test_wing_is_pitched(container, third_party, here, call):
    before, after, report = deformed(call, third_party / container, WING)
    assert report["valid"] is True
    assert (after.names, after.shapes, after.patches) == (before.names, before.shapes, before.patches)
    assert after.connections == before.connections
    assert [(p["name"], p["kind"]) for p in report["boundary"]["patches"]] == [
        ("wing", "moving"), ("far", "fixed"), ("symmetry", "symmetry"),
    ]  # fmt: skip
    topology = find_topology(before)

    def nodes_of(family: str) -> np.ndarray:
        patches = [patch for patch in before.patches if patch.family == family]
        return topology.first[np.unique(topology.quads.corners[quads_of_patches(topology.quads, patches)[0]])]

    wall, far, plane = map(nodes_of, ("wall", "Far", "Sym"))
    c, s, arm = np.cos(np.deg2rad(5)), np.sin(np.deg2rad(5)), before.points[wall] - [0.25, 0, 0]
    expected = arm @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.25, 0, 0]
    np.testing.assert_allclose(after.points[wall], expected, rtol=0, atol=1e-14)
    only_far = np.setdiff1d(far, wall)
    np.testing.assert_array_equal(after.points[only_far], before.points[only_far])
    np.testing.assert_allclose(after.points[plane, 2], before.points[plane, 2], rtol=0, atol=1e-15)
    sliding = np.setdiff1d(plane, np.union1d(wall, far))
    assert np.abs(after.points[sliding] - before.points[sliding]).max() > 0.01


def oracle(third_party: Path, name: str) -> list[np.ndarray]:
    values = np.load(third_party / "oracle" / f"{name.replace('_hdf5', '')}.npz", allow_pickle=False)
    return [values[f"b{n}"] for n in range(sum(key[0] == "b" for key in values))]


TARGETS = {
    "ascii.xyz": ("encoding=ascii",), "binary.xyz": ("encoding=binary",), "out.cgns": (), "out.vtm": (),
    "fortran.xyz": ("encoding=fortran", "byte_order=big", "markers=8"), "ascii.vtm": ("encoding=ascii",),
}  # fmt: skip


@pytest.mark.parametrize("name", GRIDS)
def test_every_grid_is_described_judged_drawn_and_converted_to_every_format_and_back(name, third_party, here, call):
    known = oracle(third_party, name)
    facts, judged = (call(command, third_party / name, "--json") for command in ("info", "quality"))
    assert json.loads(facts.out)["nodes"] == sum(block[..., 0].size for block in known)
    assert 0.0 < json.loads(judged.out)["quality"]["after"]["f_skew"]["min"] <= 1.0
    assert call("plot", third_party / name, "-o", "picture.png").code == judged.code == 0
    double = read_grid(third_party / name).precision == "float64"
    for target, variant in TARGETS.items():
        options = [word for pair in variant for word in ("--variant", pair)]
        result = call("convert", third_party / name, target, *options)
        assert result.code == 0, f"{target}: {result.err}"
        assert result.out.startswith(f"{target}: ")
        grid = read_grid(target)
        assert grid.shapes == tuple(block.shape[:3] for block in known)
        for number, block in enumerate(known):
            np.testing.assert_array_equal(grid.block(number), block, f"{target}, block {number + 1}")
        assert grid.precision == "float64" or not double
        back = f"{target}-back{Path(name).suffix}"
        assert call("convert", target, back).code == 0
        assert call("compare", third_party / name, back, "--tolerance", "0").code == 0
