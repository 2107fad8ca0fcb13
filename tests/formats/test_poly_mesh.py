"""OpenFOAM meshes as written: judged in plain numpy, and by checkMesh where it is installed."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from grids import block_around
from poly_mesh_witness import check_mesh, read_mesh, read_points

from meshdeform_cli.main import run
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, Patch, Periodicity, Side, Window
from meshdeform_core.quality.cells import block_volumes
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.openfoam.foam_files import write_points

ROOT = Path(__file__).parents[2]
THIRD_PARTY = (
    "717_wl_L2.cgns", "nak_a_141.cgns", "nak_a_141.p3dfmt", "cylinder_ring_4blk.x", "backstep5_4levdn.p3dbin",
    "shear_3blk_2d.p2dfmt", "StructuredGrid.vts", "SampleStructGrid.vtk", "turek/blockMeshDict",
)  # fmt: skip
CASE = """
[[boundary]]
name = "top"
select = ["top"]
motion = [{ displace = ["0", "0.2*t*x*(1-x)", "0"] }]
[[boundary]]
name = "sides"
select = ["defaultFaces"]
kind = "slip"
"""
DICTIONARY = """FoamFile { version 2.0; format ascii; class dictionary; object blockMeshDict; }
vertices ((0 0 0) (1 0 0) (1 1 0) (0 1 0) (0 0 0.1) (1 0 0.1) (1 1 0.1) (0 1 0.1));
blocks (hex (0 1 2 3 4 5 6 7) (6 5 1) simpleGrading (2 1 1));
boundary (top { type wall; faces ((3 7 6 2)); } bottom { type symmetryPlane; faces ((0 1 5 4)); }
          in { type patch; faces ((0 4 7 3)); } out { type patch; faces ((1 2 6 5)); });
"""


FAR = DICTIONARY.replace("(0 0 0) (1 0 0) (1 1 0) (0 1 0)", "(100 0 0) (101 0 0) (101 1 0) (100 1 0)").replace(
    "(0 0 0.1) (1 0 0.1) (1 1 0.1) (0 1 0.1)", "(100 0 0.1) (101 0 0.1) (101 1 0.1) (100 1 0.1)"
)


def box(*counts: int) -> np.ndarray:
    return block_around(*(np.arange(n + 1) / 4 for n in counts))


@pytest.mark.slow
@pytest.mark.parametrize("name", THIRD_PARTY)
def test_third_party_grids_are_sound_meshes(name, third_party, tmp_path):
    grid = read_grid(third_party / name)
    write_grid(grid, tmp_path / "case.foam")
    mesh = read_mesh(tmp_path)
    assert int(mesh.owner.max()) + 1 == grid.n_cells
    if grid.dimension == 3:
        total = np.abs(block_volumes(grid, grid.points, np.ones(grid.n_blocks))).sum()
        assert mesh.volumes().sum() == pytest.approx(total, rel=1e-9)
    # Thin cells, to which checkMesh objects where they lie along an axis.
    flaws = [line for line in check_mesh(tmp_path).splitlines() if "***" in line]
    assert not flaws or (name.startswith(("backstep", "717")) and all("***High aspect ratio" in line for line in flaws))


def test_patches_are_families_with_their_types(tmp_path):
    window = {side: Window(0, side, (0, 0), (3, 3)) for side in Side}
    x = box(3, 3, 3)
    x[:, 0, :, 1] -= x[:, 0, :, 0] ** 2
    grid = Grid.from_blocks([x], patches=(
        Patch("a", (window[Side.IMIN],), "skin", "BCWallViscous"), Patch("b", (window[Side.IMAX],), "skin"),
        Patch("curved", (window[Side.JMIN],), "", "BCSymmetryPlane"),
        Patch("mirror", (window[Side.JMAX],), "", "BCSymmetryPlane"), Patch("a b;c", (window[Side.KMIN],)),
        Patch("_z", (Window(0, Side.KMAX, (0, 0), (3, 1)),)), Patch("z_", (Window(0, Side.KMAX, (0, 1), (3, 3)),)),
    ))  # fmt: skip
    write_grid(grid, tmp_path / "case.foam")
    assert {name: (e["type"], e["nFaces"]) for name, e in read_mesh(tmp_path).patches.items()} == {
        "skin": ("wall", "18"), "curved": ("symmetry", "9"), "mirror": ("symmetryPlane", "9"),
        "a_b_c": ("patch", "9"), "_z": ("patch", "3"), "z_": ("patch", "6"),
    }  # fmt: skip


@pytest.mark.parametrize(("condition", "bend", "kind"), [("", 0, "empty"), ("BCWall", 0, "wall"), ("", 0.1, "patch")])
def test_one_layer_is_a_plane_grid_unless_it_is_bent_or_between_walls(condition, bend, kind, tmp_path):
    x = box(3, 3, 1)
    x[..., 2] += bend * x[..., 0] ** 2
    ends = [Patch(side.label, (Window(0, side, (0, 0), (3, 3)),), "", condition) for side in (Side.KMIN, Side.KMAX)]
    write_grid(Grid.from_blocks([x], patches=tuple(ends)), tmp_path / "case.foam")
    assert [read_mesh(tmp_path).patches[end.name]["type"] for end in ends] == [kind, kind]


@pytest.mark.parametrize(("turned", "rise"), [(False, 0.0), (True, 0.0), (True, 0.3)])
def test_cyclic_faces_correspond(turned, rise, tmp_path):
    """Face by face, and corner by corner in opposite order."""
    x = box(3, 4, 2)
    center, angle, shift = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    if turned:
        radius, phi = 1 + x[..., 0], 0.7 * x[..., 1]
        x = np.stack([radius * np.cos(phi), radius * np.sin(phi), x[..., 2] + rise * x[..., 1]], axis=-1)
        angle, shift = (0.0, 0.0, float(np.degrees(0.7))), (0.0, 0.0, rise)
    motion = Periodicity(center, angle, shift)
    ends = Connection("p", 0, (0, 0, 0), (3, 0, 2), 0, (0, 4, 0), (3, 4, 2), (1, 2, 3), motion)
    write_grid(Grid.from_blocks([x], connections=(ends,)), tmp_path / "case.foam", {"encoding": "ascii"})
    mesh = read_mesh(tmp_path)
    pair = [name for name, entries in mesh.patches.items() if entries["type"] == "cyclic"]
    assert len(pair) == 2
    for one, two in zip(*(mesh.patch_faces(name) for name in pair), strict=True):
        p, q = mesh.points[one], mesh.points[[two[0], *two[:0:-1]]]
        if turned:
            c, s = np.cos(0.7), np.sin(0.7)
            p = p @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        np.testing.assert_allclose(p + np.array(shift), q, atol=1e-12)
    ways = ["(0.0 1.0 0.0)", "(0.0 -1.0 0.0)"]
    assert [mesh.patches[name].get("separationVector") for name in pair] == ([None, None] if turned else ways)
    kind = "unknown" if rise else "rotational" if turned else "translational"
    assert [mesh.patches[name]["transform"] for name in pair] == [kind, kind]
    assert "Mesh OK." in check_mesh(tmp_path)


def test_periodic_connections_of_plane_blocks_that_lack_different_indices(tmp_path):
    x, y = np.meshgrid(np.arange(6.0), np.arange(3.0), indexing="ij")
    plane = np.stack([x, y, 0 * x], axis=-1)
    motion = Periodicity(translation=(5.0, 0.0, 0.0))
    around = Connection("p", 0, (0, 0, 0), (0, 0, 2), 1, (2, 0, 0), (2, 2, 0), (1, 3, 2), motion)
    grid = Grid.from_blocks([plane[:4, None], plane[3:, :, None]], connections=(around,))
    write_grid(grid, tmp_path / "case.foam", {"thickness": 0.5})
    cyclic = [entries for entries in read_mesh(tmp_path).patches.values() if entries["type"] == "cyclic"]
    assert [entries["separationVector"] for entries in cyclic] == ["(5.0 0.0 0.0)", "(-5.0 0.0 0.0)"]
    assert [entries["nFaces"] for entries in cyclic] == ["2", "2"]
    for thickness in ("0", "-1", "x", "1e30"):
        with pytest.raises(FormatError, match=f"thickness = '{thickness}'; expected a length"):
            write_grid(grid, tmp_path / "case.foam", {"thickness": thickness})


def test_collapsed_hexahedra_are_prisms_and_pyramids(tmp_path):
    x = box(3, 3, 3)
    wedge, tip = x.copy(), x.copy()
    wedge[..., 1] *= x[..., 0]
    tip[..., 1:] *= x[..., :1]
    for number, nodes in enumerate((wedge, tip)):
        case = tmp_path / str(number)
        write_grid(Grid.from_blocks([nodes]), case / "case.foam")
        mesh = read_mesh(case)
        inside = mesh.corners[: len(mesh.neighbour)]
        corners = {len(np.union1d(mesh.corners[mesh.owner == c], inside[mesh.neighbour == c])) for c in range(27)}
        assert corners == ({8, 6} if number == 0 else {8, 5})
        assert "Mesh OK." in check_mesh(case)


@pytest.mark.parametrize(("one", "two"), [((0, 0, 1), (1, 1, 1)), ((1, 0, 1), (0, 1, 1))])
def test_faces_through_one_point_twice_are_refused(one, two, tmp_path):
    x = box(1, 1, 2)
    x[one] = x[two]
    with pytest.raises(FormatError, match=r"1 cell faces pass through one point twice, the first \[\d"):
        write_grid(Grid.from_blocks([x]), tmp_path / "case.foam")


def test_left_handed_blocks_and_rings(tmp_path):
    """A ring closed on itself, left-handed, next to a right-handed block."""
    r, phi, z = np.meshgrid(np.linspace(1, 2, 4), np.linspace(0, 2 * np.pi, 9), [0, 0.5, 1.0], indexing="ij")
    ring = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
    ring[:, -1] = ring[:, 0]
    outer = ring * [1, 1, 1] + np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=-1)
    outer[0], outer[:, -1] = ring[-1], outer[:, 0]
    write_grid(Grid.from_blocks([ring[:, ::-1].copy(), outer]), tmp_path / "case.foam")
    assert len(read_mesh(tmp_path).patches) == 6
    assert "Mesh OK." in check_mesh(tmp_path)
    # A ring of a single cell, whose first and last nodes are the same.
    one_cell = np.stack([ring[:, 0], ring[:, 0]], axis=1)
    with pytest.raises(FormatError, match="its own neighbour"):
        write_grid(Grid.from_blocks([one_cell]), tmp_path / "other.foam")


def made_case(folder: Path, shuffled: bool = True, dictionary: str = DICTIONARY) -> np.ndarray:
    """A case with a dictionary and a mesh of it whose points have other numbers; returns them."""
    (folder / "system").mkdir(parents=True)
    (folder / "system/blockMeshDict").write_text(dictionary)
    grid = read_grid(folder / "system/blockMeshDict")
    write_grid(grid, folder / "x.foam", {"encoding": "ascii"})
    order = np.random.default_rng(1).permutation(len(read_mesh(folder).points))
    points = read_mesh(folder).points[order] if shuffled else read_mesh(folder).points
    write_points(folder / "constant/polyMesh/points", points, "constant/polyMesh", False)
    return points


@pytest.mark.parametrize("end", ["", ".gz"])
def test_an_existing_mesh_gets_new_points_only(end, tmp_path):
    """Numbers of points, faces and patches stay those of the mesh, whatever they are, packed or not."""
    points = made_case(tmp_path / "old")
    if end:
        for file in (tmp_path / "old/constant/polyMesh").iterdir():
            file.with_name(file.name + end).write_bytes(gzip.compress(file.read_bytes()))
            file.unlink()
    (tmp_path / "case.toml").write_text(CASE)
    arguments = ["deform", str(tmp_path / "old"), "-c", str(tmp_path / "case.toml"), "--time", "1", "-q"]
    assert run([*arguments, "-o", str(tmp_path / "new") + "/"]) == 0
    for name in ("faces", "owner", "neighbour", "boundary"):
        old, new = ((tmp_path / case / f"constant/polyMesh/{name}{end}").read_bytes() for case in ("old", "new"))
        assert old == new
    moved = read_points(tmp_path / "new/constant/polyMesh/points")
    top = points[:, 1] == 1
    x = points[top, 0]
    np.testing.assert_allclose(moved[top, 1], 1 + 0.2 * x * (1 - x), atol=1e-14)
    np.testing.assert_array_equal(moved[~top & (points[:, 1] == 0)], points[~top & (points[:, 1] == 0)])
    np.testing.assert_allclose(moved[:, 2], points[:, 2], atol=1e-15)


def test_a_mesh_that_is_not_that_of_the_dictionary_is_refused(tmp_path):
    points = made_case(tmp_path)
    other = points.copy()
    other[17] += 0.003
    cases = [(other, "1 points are not where the blocks"), (points[:-1], "83 points.*have 84 nodes")]
    cases += [(np.vstack([points, points]), "168 points.*have 84 nodes")]
    for value in (np.nan, np.inf, 1e200):
        bad = points.copy()
        bad[5, 1] = value
        cases.append((bad, r"point 5 is \(.*\); expected finite coordinates up to 1e\+30"))
    for wrong, message in cases:
        write_points(tmp_path / "constant/polyMesh/points", wrong, "x", True)
        with pytest.raises(FormatError, match=message):
            read_grid(tmp_path)
    (tmp_path / "constant/polyMesh/points").write_bytes(b"FoamFile { class vectorField; format binary; } 84\n(short")
    with pytest.raises(FormatError, match="truncated"):
        read_grid(tmp_path)


DAMAGE = [
    ("faces", r"4\((\d+) (\d+) \d+ \d+\)", r"2(\1 \2)", "faces need three or more corners"),
    ("faces", r"\n4\(", r"\n5(", "the sizes of its 131 faces do not fit"),
    ("faces", r"4\(\d+ ", "4(84 ", "faces has numbers from 0 to 84, expected 0 to 83"),
    ("faces", r"4\((\d+) (\d+) ", r"4(\2 \1 ", "2 cells are not closed by the faces of"),
    ("owner", r"\(\n0\n", r"(\n30\n", "owner has numbers from 0 to 30, expected 0 to 29"),
    ("owner", r"131\n\(\n0\n", r"130\n(\n", "faces has 131 faces, owner 130 and neighbour 49"),
    ("neighbour", r"\(\n1\n", r"(\n-1\n", "neighbour has numbers from -1 to 29, expected 0 to 29"),
    ("boundary", r"startFace +\d+", "startFace 0", "top of boundary begins at face 0, expected 49; run blockMesh"),
    ("boundary", r"nFaces +\d+", "nFaces -6", "patch top of boundary begins at face 49, expected 49"),
    ("boundary", r"nFaces +60", "nFaces 59", "the patches of boundary end at face 130, expected 131"),
]


@pytest.mark.parametrize(("name", "old", "new", "message"), DAMAGE)
def test_damaged_meshes_are_refused(name, old, new, message, tmp_path):
    made_case(tmp_path, shuffled=False)
    file = tmp_path / "constant/polyMesh" / name
    head, end, rest = file.read_text().partition("}")
    file.write_text(head + end + re.sub(old, new, rest, count=1))
    with pytest.raises(FormatError, match=message):
        read_grid(tmp_path)


@pytest.mark.parametrize("dictionary", [DICTIONARY, FAR], ids=["near", "far"])
def test_points_of_six_digits_are_found(dictionary, tmp_path):
    """Also where half a unit of the last digit is more than the tolerance of coincident nodes."""
    points = made_case(tmp_path, dictionary=dictionary)
    text = "\n".join("(" + " ".join(f"{v:.6g}" for v in p) + ")" for p in points.tolist())
    head = "FoamFile { class vectorField; format ascii; }\n"
    (tmp_path / "constant/polyMesh/points").write_text(f"{head}{len(points)}\n(\n{text}\n)\n")
    grid = read_grid(tmp_path)
    np.testing.assert_array_equal(grid.points, read_grid(tmp_path / "system/blockMeshDict").points)
    assert "has 6 digits only" in grid.notes[0]


def test_series_of_points(tmp_path, capsys):
    made_case(tmp_path / "old", shuffled=False)
    (tmp_path / "case.toml").write_text(CASE)
    arguments = ["series", str(tmp_path / "old"), "-c", str(tmp_path / "case.toml"), "--times", "0:1:0.5"]
    out = tmp_path / "out"
    assert run([*arguments, "-o", str(out), "-q"]) == 0
    names = ["0", "0.5", "1", "constant", "old.foam", "series.json", "system"]
    assert sorted(path.name for path in out.iterdir()) == names
    for time in ("0", "0.5", "1"):
        mesh = read_mesh(out, out / time / "polyMesh/points")
        top = np.flatnonzero(read_mesh(out).points[:, 1] == 1)
        x, y, _ = mesh.points[top].T
        np.testing.assert_allclose(y, 1 + 0.2 * float(time) * x * (1 - x), atol=1e-14)
    assert "Mesh OK." in check_mesh(out)
    capsys.readouterr()
    assert run([*arguments, "-o", str(tmp_path / "v"), "--velocity", "first"]) == 2
    assert "omit --velocity" in capsys.readouterr().err


def test_a_solver_runs_on_the_points_of_a_series(tmp_path, monkeypatch):
    """As the page says: it conserves mass and takes the points as they are."""
    if shutil.which("pimpleFoam") is None:
        pytest.skip("OpenFOAM is not installed")
    monkeypatch.chdir(tmp_path)
    (script,) = re.findall(r"(?s)```sh\n(mkdir.*?)meshdeform info", (ROOT / "docs/guides/openfoam.md").read_text())
    subprocess.run(["sh", "-c", script], check=True)
    command = ["series", "flap/", "-c", "flap.toml", "--times", "0:1:0.25", "--variant", "encoding=ascii", "-q"]
    assert run([*command, "-o", "moving"]) == 0

    def errors(said: str) -> list[float]:
        return [float(error) for error in re.findall(r"sum local = ([^,]+),", said)]

    example = ["sh", str(ROOT / "examples/openfoam.sh"), "moving", "run"]
    said = subprocess.run(example, check=True, capture_output=True, text=True).stdout
    assert len(errors(said)) == 3 * 40
    assert max(errors(said)) < 1e-10
    for time in ("0.25", "0.5", "0.75", "1"):
        known, found = (read_points(Path(case, time, "polyMesh/points")) for case in ("moving", "run"))
        np.testing.assert_allclose(found, known, rtol=0, atol=1e-15)


def test_outputs_never_replace_inputs_or_other_meshes(tmp_path, capsys):
    made_case(tmp_path / "old", shuffled=False)
    inside = str(tmp_path / "old") + "/"
    assert run(["convert", inside, inside, "--force"]) == 2
    assert "would replace" in capsys.readouterr().err
    box_file, new = tmp_path / "box.xyz", tmp_path / "new"
    write_grid(Grid.from_blocks([box(2, 2, 2)]), box_file)
    assert run(["convert", str(box_file), f"{new}/", "-q"]) == 0
    before = (new / "constant/polyMesh/points").read_bytes()
    (new / "new.foam").unlink()
    assert run(["convert", str(box_file), f"{new}/"]) == 2
    assert "points exists; use --force" in capsys.readouterr().err
    (new / "constant/polyMesh/cellZones.gz").write_text("")
    assert run(["convert", str(box_file), f"{new}/", "--force"]) == 2
    assert "cellZones of another mesh" in capsys.readouterr().err
    assert (new / "constant/polyMesh/points").read_bytes() == before
    assert run(["convert", str(box_file), str(tmp_path / "a/b") + "/"]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_invalid_grids_go_to_a_case_of_their_own(tmp_path):
    made_case(tmp_path / "old", shuffled=False)
    (tmp_path / "case.toml").write_text(CASE.replace("0.2*t*x*(1-x)", "-8*t*x*(1-x)"))
    arguments = ["deform", str(tmp_path / "old"), "-c", str(tmp_path / "case.toml"), "--time", "1", "-q"]
    assert run([*arguments, "-o", str(tmp_path / "new") + "/", "--steps", "1", "--repair", "off"]) == 3
    assert not (tmp_path / "new/constant").exists()
    assert (tmp_path / "new.invalid/constant/polyMesh/points").is_file()
