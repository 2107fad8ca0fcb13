"""Real grids of other people: deformed as their owners would, converted to everything and back."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.grid.topology import find_topology
from meshdeform_formats import read_grid

pytestmark = pytest.mark.slow

GRIDS = (
    "717_wl_L2.cgns",
    "717_wl_L2_hdf5.cgns",
    "nak_a_141.cgns",
    "nak_a_141.p3dfmt",
    "cylinder_ring_4blk.x",
    "backstep5_4levdn.p3dbin",
    "shear_3blk_2d.p2dfmt",
    "StructuredGrid.vts",
    "SampleStructGrid.vtk",
)

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

AIRFOIL = """
[grid]
boundary_file = "nak_a_141.nmf"

[[boundary]]
name = "airfoil"
select = ["viscous_solid"]
motion = [
  { rotate = { angle = "-10", axis = [0, 1, 0] } },
  { translate = [0, 0, 0.05] },
]

[[boundary]]
name = "ends"
select = ["symmetry_y"]
kind = "slip"
"""


def turned(points: np.ndarray, degrees: float, axis: int, center: tuple[float, float, float]) -> np.ndarray:
    a, b = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    arm = points - center
    result = arm.copy()
    result[:, a], result[:, b] = c * arm[:, a] - s * arm[:, b], s * arm[:, a] + c * arm[:, b]
    return result + center


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
    nodes = {name: [] for name in ("wall", "Far", "Sym")}
    for patch in before.patches:
        for window in patch.windows:
            block = np.arange(before.n_nodes)[before.offsets[window.block] : before.offsets[window.block + 1]]
            side = np.take(block.reshape(before.shapes[window.block]), -(window.side % 2), axis=window.side.axis)
            nodes[patch.family].append(side.ravel())
    wall, far, plane = (np.unique(np.concatenate(parts)) for parts in nodes.values())
    expected = turned(before.points[wall], 5.0, 2, (0.25, 0.0, 0.0))
    np.testing.assert_allclose(after.points[wall], expected, rtol=0, atol=1e-14)
    only_far = np.setdiff1d(far, wall)
    np.testing.assert_array_equal(after.points[only_far], before.points[only_far])
    np.testing.assert_allclose(after.points[plane, 2], before.points[plane, 2], rtol=0, atol=1e-15)
    sliding = np.setdiff1d(plane, np.union1d(wall, far))
    assert np.abs(after.points[sliding] - before.points[sliding]).max() > 0.01


def test_airfoil_with_its_neutral_map(third_party, here, call):
    shutil.copy(third_party / "nak_a_141.nmf", here)
    before, after, report = deformed(call, third_party / "nak_a_141.p3dfmt", AIRFOIL)
    assert report["valid"] is True
    patches = {p["name"]: (p["kind"], p["nodes"]) for p in report["boundary"]["patches"]}
    # 65 nodes with the trailing edge twice, two layers.
    assert patches["airfoil"] == ("moving", 128)
    assert patches["ends"][0] == "slip"
    wall = before.block(0)[:, 38:103, 0].reshape(-1, 3)
    expected = turned(wall, -10.0, 1, (0.0, 0.0, 0.0)) + [0.0, 0.0, 0.05]
    np.testing.assert_allclose(after.block(0)[:, 38:103, 0].reshape(-1, 3), expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(after.points[:, 1], before.points[:, 1])
    np.testing.assert_array_equal(after.block(0)[:, :, -1], before.block(0)[:, :, -1])


def oracle(third_party: Path, name: str) -> list[np.ndarray]:
    values = np.load(third_party / "oracle" / f"{name.replace('_hdf5', '')}.npz", allow_pickle=False)
    return [values[f"b{n}"] for n in range(sum(key[0] == "b" for key in values))]


TARGETS = {
    "ascii.xyz": ("encoding=ascii",),
    "binary.xyz": ("encoding=binary",),
    "fortran.xyz": ("encoding=fortran", "byte_order=big", "markers=8"),
    "out.cgns": (),
    "out.vtm": (),
    "ascii.vtm": ("encoding=ascii",),
}


@pytest.mark.parametrize("name", GRIDS)
def test_every_grid_converts_to_every_format_and_back(name, third_party, here, call):
    known = oracle(third_party, name)
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


@pytest.mark.parametrize("name", GRIDS)
def test_every_grid_is_described_judged_and_drawn(name, third_party, here, call):
    facts = json.loads(call("info", third_party / name, "--json").out)
    known = oracle(third_party, name)
    assert facts["nodes"] == sum(block[..., 0].size for block in known)
    result = call("quality", third_party / name, "--json")
    assert result.code == 0
    report = json.loads(result.out)
    assert 0.0 < report["quality"]["after"]["f_skew"]["min"] <= 1.0
    assert call("plot", third_party / name, "-o", "picture.png").code == 0
