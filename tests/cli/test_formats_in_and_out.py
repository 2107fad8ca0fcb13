"""A grid in any format gives the same deformed grid in any other, for every method; files by independent witnesses."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import cgns_witness
import h5py
import numpy as np
import plot3d_witness
import pytest
import vtk_witness
from grids import polar

from meshdeform_core.methods import CATALOGUE

CASE = """\
[[boundary]]
select = ["*"]
where = "x*x + y*y < 1.01"
motion = [{ rotate = { angle = 15.0 } }, { displace = ["0.1", "0", "0.02*sin(pi*z)"] }]

[[boundary]]
select = ["*"]
where = "x*x + y*y > 8.99"
kind = "fixed"

[[boundary]]
select = ["*"]
where = "z < 1e-9 or z > 1 - 1e-9"
kind = "slip"
"""
WHOLE = polar(16, 6, 3).block(0)
PARTS = [WHOLE[:9], WHOLE[8:]]
Blocks = list[np.ndarray]


def write_plot3d(path: Path, blocks: Blocks, **variant: object) -> None:
    path.write_bytes(plot3d_witness.binary_file(blocks, **variant))


def write_ascii(path: Path, blocks: Blocks) -> None:
    path.write_text(plot3d_witness.ascii_file(blocks))


def write_cgns(path: Path, blocks: Blocks) -> None:
    cgns_witness.write_hdf5(path, cgns_witness.tree(*(cgns_witness.zone(f"z{n}", x) for n, x in enumerate(blocks))))


def write_vtm(path: Path, blocks: Blocks) -> None:
    path.with_suffix("").mkdir()
    for n, x in enumerate(blocks):
        vtk_witness.write_xml(path.with_suffix("") / f"{n}.vts", vtk_witness.structured_grid(x))
    sets = "".join(f'<DataSet index="{n}" file="{path.stem}/{n}.vts"/>' for n in range(len(blocks)))
    kind = "vtkMultiBlockDataSet"
    path.write_text(f'<VTKFile type="{kind}" version="1.0"><{kind}>{sets}</{kind}></VTKFile>')


def read_plot3d(path: Path) -> Blocks:
    """C binary, little endian, double precision: what ``deform`` is told to write."""
    data = path.read_bytes()
    count = int(np.frombuffer(data, "<i4", 1)[0])
    return _split(np.frombuffer(data, "<i4", 3 * count, 4), np.frombuffer(data, "<f8", -1, 4 + 12 * count))


def read_big_fortran(path: Path) -> Blocks:
    """Big endian, 8-byte markers, a record for each block."""
    data, records = path.read_bytes(), []
    while data:
        size = int.from_bytes(data[:8], "big")
        records.append(data[8 : 8 + size])
        assert data[8 + size : 16 + size] == data[:8]
        data = data[16 + size :]
    values = np.concatenate([np.frombuffer(record, ">f8") for record in records[2:]])
    return _split(np.frombuffer(records[1], ">i4"), values)


def read_ascii(path: Path) -> Blocks:
    numbers = path.read_text().split()
    count = int(numbers[0])
    return _split(np.array(numbers[1 : 1 + 3 * count], int), np.array(numbers[1 + 3 * count :], float))


def _split(sizes: np.ndarray, values: np.ndarray) -> Blocks:
    shapes = sizes.reshape(-1, 3).tolist()
    ends = np.cumsum([3 * np.prod(shape) for shape in shapes])
    assert ends[-1] == len(values)
    runs = np.split(values, ends[:-1])
    return [run.reshape(3, *shape[::-1]).transpose(3, 2, 1, 0) for run, shape in zip(runs, shapes, strict=True)]


def read_cgns(path: Path) -> Blocks:
    with h5py.File(path) as file:
        (base,) = (group for group in file.values() if group.attrs.get("label") == b"CGNSBase_t")
        zones = [group for group in base.values() if group.attrs.get("label") == b"Zone_t"]
        return [
            np.stack([zone[f"GridCoordinates/Coordinate{c}/ data"][()].T for c in "XYZ"], axis=-1) for zone in zones
        ]


def read_vtk(path: Path) -> Blocks:
    return [vtk_witness.read(path)[0]]


def read_vtm(path: Path) -> Blocks:
    sets = ET.parse(path).getroot().iter("DataSet")
    return [vtk_witness.read(path.parent / element.attrib["file"])[0] for element in sets]


# Suffix, writer and blocks of the input.
INPUTS: dict[str, tuple[str, Callable[..., None], Blocks]] = {
    "ascii": (".p3dfmt", write_ascii, PARTS),
    "binary": (".xyz", lambda p, b: write_plot3d(p, b, encoding="binary", byte_order="big"), PARTS),
    "fortran": (".p3dbin", lambda p, b: write_plot3d(p, b, encoding="fortran", records="plane"), PARTS),
    "fortran-8": (".g", lambda p, b: write_plot3d(p, b, encoding="fortran", markers=8, records="array"), PARTS),
    "cgns": (".cgns", write_cgns, PARTS),
    "vtm": (".vtm", write_vtm, PARTS),
    "vts": (".vts", lambda p, b: vtk_witness.write_xml(p, vtk_witness.structured_grid(b[0])), [WHOLE]),
    "vtk": (".vtk", lambda p, b: vtk_witness.write_legacy(p, vtk_witness.structured_grid(b[0]), False), [WHOLE]),
    "vtk-binary": (".vtk", lambda p, b: vtk_witness.write_legacy(p, vtk_witness.structured_grid(b[0])), [WHOLE]),
}
# Suffix, variant and reader of the output.
OUTPUTS: dict[str, tuple[str, tuple[str, ...], Callable[[Path], Blocks]]] = {
    "ascii": (".p3dfmt", ("encoding=ascii", "multiblock=true"), read_ascii),
    "binary": (".xyz", ("encoding=binary", "byte_order=little", "multiblock=true"), read_plot3d),
    "fortran": (
        ".p3dbin",
        ("encoding=fortran", "byte_order=big", "markers=8", "records=block", "multiblock=true"),
        read_big_fortran,
    ),
    "cgns": (".cgns", (), read_cgns),
    "vtm": (".vtm", (), read_vtm),
    "vts": (".vts", (), read_vtk),
    "vtk": (".vtk", ("encoding=ascii",), read_vtk),
}
SINGLE = {"vts", "vtk", "vtk-binary"}
METHODS = list(CATALOGUE)
PAIRS = [(source, target) for source in INPUTS for target in OUTPUTS if target not in SINGLE or source in SINGLE]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Blocks]:
    """The deformed blocks for a method and a number of blocks: from ASCII to ASCII."""
    from meshdeform_cli.main import run

    folder, known = tmp_path_factory.mktemp("expected"), {}
    (folder / "case.toml").write_text(CASE)

    def of(method: str, count: int) -> Blocks:
        if (method, count) not in known:
            write_ascii(folder / "grid.x", [WHOLE] if count == 1 else PARTS)
            assert run(deform(folder, method, folder / "grid.x", folder / "out.x")) == 0
            known[method, count] = read_ascii(folder / "out.x")
        return known[method, count]

    return of


def deform(folder: Path, method: str, source: Path, target: Path, *more: str) -> list[str]:
    command = ["deform", str(source), "-c", str(folder / "case.toml"), "-m", method, "-o", str(target), "-q"]
    return [*command, "--force", "--strict", "--repair", "off", *more]


def assert_as_expected(moved: Blocks, blocks: Blocks, known: Blocks, accuracy: float) -> None:
    assert [x.shape for x in moved] == [x.shape for x in blocks]
    for new, old, right in zip(moved, blocks, known, strict=True):
        assert new.dtype.itemsize == 8
        assert np.abs(new - right).max() < accuracy
        # The motion itself: 15 degrees and a shift at the wall, nothing at the outside.
        wall = np.hypot(old[..., 0], old[..., 1]) < 1.001
        assert np.abs(np.hypot(new[..., 0] - 0.1, new[..., 1])[wall] - 1.0).max() < max(accuracy, 1e-12)
        outside = np.hypot(old[..., 0], old[..., 1]) > 2.999
        assert np.abs(new[outside][:, :2] - old[outside][:, :2]).max() < accuracy


@pytest.mark.parametrize(
    ("source", "target"),
    [pytest.param(*pair, id=" to ".join(pair), marks=() if "ascii" in pair else pytest.mark.slow) for pair in PAIRS],
)
def test_same_result_from_and_to(source, target, expected, tmp_path, call):
    """The methods take turns: every one meets several inputs and outputs."""
    method = METHODS[PAIRS.index((source, target)) % len(METHODS)]
    (tmp_path / "case.toml").write_text(CASE)
    suffix, write, blocks = INPUTS[source]
    write(tmp_path / f"grid{suffix}", blocks)
    suffix_out, variant, read = OUTPUTS[target]
    output = tmp_path / f"moved{suffix_out}"
    options = [word for pair in variant for word in ("--variant", pair)]
    result = call(*deform(tmp_path, method, tmp_path / f"grid{suffix}", output, *options))
    assert (result.code, result.err) == (0, "")
    # VTK writes eleven digits in ASCII.
    accuracy = 1e-9 if source == "vtk" else 1e-14
    assert_as_expected(read(output), blocks, expected(method, len(blocks)), accuracy)
