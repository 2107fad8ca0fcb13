"""Unstructured files, read back by meshio (and by hand where it drops names)."""

import dataclasses
from collections import Counter

import meshio
import numpy as np
import pytest
from grids import block_around, whole_face

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Field, Grid, Patch, Periodicity, Side, Window
from meshdeform_formats import write_grid
from meshdeform_formats.grids import complete_for_export

FORMATS = {".vtu": "vtu", ".msh": "gmsh", ".med": "med", ".su2": "su2", ".inp": "abaqus"}


def box(low, high, shape):
    return block_around(*(np.linspace(a, b, n) for a, b, n in zip(low, high, shape, strict=True)))


def two_blocks():
    """Two unit-high boxes that share a face; the second is left-handed."""
    first, second = box((0, 0, 0), (1, 1, 1), (3, 3, 4)), box((1, 0, 0), (3, 1, 1), (5, 3, 4))[::-1]
    wall = Patch("lower wall", (whole_face((3, 3, 4), 0, Side.JMIN), Window(1, Side.JMIN, (0, 0), (2, 3))))
    shared, empty = Patch("interface", (whole_face((3, 3, 4), 0, Side.IMAX),)), Patch("without faces", ())
    fields = (
        Field("x", "node", 1, second[..., 0]),
        Field("x", "node", 0, first[..., 0]),
        *(Field("mixed", "node", b, np.ones((3 + 2 * b, 3, 4, 2 + b))) for b in (0, 1)),
        Field("centre", "cell", 0, _centres(first)),
        Field("centre", "cell", 1, _centres(second)),
        Field("flag", "node", 0, np.ones((3, 3, 4), dtype=bool)),
        *(Field("small", "cell", b, np.full((2 + 2 * b, 2, 3), b, np.int16)) for b in (0, 1)),
    )
    return Grid.from_blocks([first, second], ["left", "right"], patches=(wall, shared, empty), fields=fields)


def _centres(points):
    for _ in range(3):
        points = np.moveaxis(points[1:] + points[:-1], 0, 2) / 2
    return points


def export(grid, path, **options):
    write_grid(grid, path, options)
    return meshio.read(path, file_format=FORMATS[path.suffix])


def volumes(points, cells):
    """Volumes of hexahedra by the divergence theorem, corners in VTK's order."""
    faces = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    total = 0.0
    for face in faces:
        a, b, c, d = (points[cells[:, corner]] for corner in face)
        total = total + np.einsum("ni,ni->n", (a + b + c + d) / 4, np.cross(c - a, d - b) / 2)
    return total / 3


@pytest.mark.parametrize("suffix", FORMATS)
def test_cells_of_all_formats(tmp_path, suffix):
    grid = two_blocks()
    mesh = export(grid, tmp_path / f"a{suffix}")
    # 3 x 3 x 4 and 5 x 3 x 4 nodes, of which 3 x 4 coincide.
    assert mesh.points.shape == (36 + 60 - 12, 3)
    cells = mesh.cells_dict["hexahedron"]
    assert len(cells) == grid.n_cells
    volume = volumes(mesh.points, cells)
    np.testing.assert_allclose(volume, np.repeat([1 / 12, 2 / 24], [12, 24]), rtol=1e-13)
    centres = mesh.points[cells].mean(axis=1)
    expected = np.concatenate([_centres(grid.block(b)).reshape(-1, 3) for b in (0, 1)])
    np.testing.assert_allclose(centres, expected, atol=1e-15)


PATCHES = {"lower wall": 6 + 6, "left.imin": 6, "left.jmax": 6, "left.kmin": 4, "left.kmax": 4}
PATCHES |= {"right.imin": 6, "right.jmin": 6, "right.jmax": 12, "right.kmin": 8, "right.kmax": 8}


def check_outward(points, quads):
    """Quads of the two boxes look away from their middle."""
    a, b, c, d = (points[quads[:, corner]] for corner in range(4))
    normal = np.cross(c - a, d - b)
    assert (np.einsum("ni,ni->n", normal, (a + b + c + d) / 4 - [1.5, 0.5, 0.5]) > 0).all()


def test_groups_of_med_and_node_sets_of_abaqus(tmp_path):
    mesh = export(two_blocks(), tmp_path / "a.med")
    tags = np.concatenate(list(mesh.cell_data_dict["cell_tags"].values()))
    found = {names[0]: int((tags == tag).sum()) for tag, names in mesh.cell_tags.items()}
    assert found == PATCHES | {"left": 12, "right": 24}
    mesh = export(two_blocks(), tmp_path / "a.inp")
    assert set(mesh.point_sets) == {name.replace(" ", "_") for name in PATCHES}
    assert (mesh.points[mesh.point_sets["left.imin"]][:, 0] == 0).all()
    assert len(mesh.point_sets["left.imin"]) == 12


def su2_markers(path):
    """Elements of each marker of a SU2 file."""
    lines = iter(path.read_text().splitlines())
    found = {}
    for line in lines:
        if line.startswith("MARKER_TAG="):
            name, number = line.split("= ")[1], int(next(lines).split("= ")[1])
            found[name] = np.array([next(lines).split() for _ in range(number)], dtype=int)
    return found


@pytest.mark.parametrize(("flat", "normal"), [(0, 1), (1, 1), (2, 0)])
@pytest.mark.parametrize("left_handed", [False, True])
def test_plane_su2(tmp_path, flat, normal, left_handed):
    shape = tuple(1 if axis == flat else n for axis, n in enumerate((3, 4, 5)))
    plane = np.stack(np.meshgrid(*(np.arange(n) / n for n in shape if n > 1), indexing="ij"), axis=-1)
    points = np.insert(plane, normal, 0.5, axis=-1).reshape(*shape, 3)
    if left_handed:
        points = np.flip(points, axis=(flat + 1) % 3)
    first = next(axis for axis in range(3) if axis != flat)
    patch = Patch("inlet", (whole_face(shape, 0, Side(2 * first)),))
    mesh = export(Grid.from_blocks([points], patches=(patch,)), tmp_path / "a.su2")
    assert mesh.points.shape[1] == 2
    quads = mesh.cells_dict["quad"]
    assert len(quads) == np.prod([n - 1 for n in shape if n > 1])
    a, b, c, d = mesh.points[quads].transpose(1, 0, 2)
    assert (np.linalg.det(np.stack([c - a, d - b], axis=1)) > 0).all()
    inlet = su2_markers(tmp_path / "a.su2")["inlet"]
    assert inlet.shape == (next(n for a, n in enumerate(shape) if a not in (first, flat)) - 1, 3)
    assert (inlet[:, 0] == 3).all()


def test_a_curved_surface_is_no_su2_grid(tmp_path):
    points = box((0, 0, 0), (1, 1, 0), (3, 3, 1))
    points[..., 2] = 1e-6 * points[..., 0] ** 2
    grid = Grid.from_blocks([points])
    with pytest.raises(FormatError, match="a 2-D SU2 grid must be plane"):
        write_grid(grid, tmp_path / "a.su2")
    assert not list(tmp_path.iterdir())
    assert len(export(grid, tmp_path / "a.vtu").cells_dict["quad"]) == 4


def test_collapsed_hexahedra_stay_hexahedra(tmp_path):
    points = box((0, 0, 0), (1, 1, 1), (3, 3, 3))
    points[0, :, :, 1] = 0
    mesh = export(Grid.from_blocks([points]), tmp_path / "a.vtu")
    cells = mesh.cells_dict["hexahedron"]
    assert len(cells) == 8
    assert sorted(len(set(cell)) for cell in cells.tolist()) == [6, 6, 6, 6, 8, 8, 8, 8]
    assert len(mesh.points) == 27 - 6
    assert (volumes(mesh.points, cells) > 0).all()


def with_families():
    """Two blocks whose walls are one family; a periodic pair across y."""
    grid = two_blocks()
    family = [Patch(f"w{b}", (whole_face(grid.shapes[b], b, Side.KMIN),), "skin") for b in (0, 1)]
    motion = Periodicity(translation=(0.0, 1.0, 0.0))
    pairs = [
        Connection(f"p{b}", b, (0, 0, 0), (i - 1, 0, k - 1), b, (0, j - 1, 0), (i - 1, j - 1, k - 1), (1, 2, 3), motion)
        for b, (i, j, k) in enumerate(grid.shapes)
    ]
    return dataclasses.replace(grid, patches=(*family, grid.patches[2]), connections=tuple(pairs))


FAMILIES = {"skin": 4 + 8, "left.imin": 6, "left.kmax": 4, "right.imin": 6, "right.kmax": 8}
PERIODIC = {"periodic1": 6 + 12, "periodic1_donor": 6 + 12}


def test_su2_has_a_marker_per_family_and_side_of_a_pair(tmp_path):
    mesh = export(with_families(), tmp_path / "a.su2")
    text = (tmp_path / "a.su2").read_text()
    assert text.startswith("NDIME= 3\nNELEM= 36\n12 ")
    assert f"NMARK= {len(FAMILIES | PERIODIC)}\n" in text
    markers = su2_markers(tmp_path / "a.su2")
    assert {name: len(rows) for name, rows in markers.items()} == FAMILIES | PERIODIC
    for rows in markers.values():
        assert (rows[:, 0] == 9).all()
        check_outward(mesh.points, rows[:, 1:])
    one, two = (mesh.points[markers[name][:, 1:]].mean(axis=1) for name in PERIODIC)
    np.testing.assert_allclose(one + [0, 1, 0], two, atol=1e-15)


def test_a_family_keeps_its_other_faces_beside_periodic_ones(tmp_path):
    grid = with_families()
    skin = Patch("w0", (*grid.patches[0].windows, whole_face(grid.shapes[0], 0, Side.JMIN)), "skin")
    export(dataclasses.replace(grid, patches=(skin, *grid.patches[1:])), tmp_path / "a.su2")
    found = {name: len(rows) for name, rows in su2_markers(tmp_path / "a.su2").items()}
    assert found == FAMILIES | {"periodic1": 6, "left.jmax": 6, "right.jmin": 12, "right.jmax": 12}


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_gmsh_groups(encoding, tmp_path):
    mesh = export(with_families(), tmp_path / "a.msh", encoding=encoding)
    head = f"$MeshFormat\n2.2 {int(encoding == 'binary')} 8\n"
    assert (tmp_path / "a.msh").read_bytes().startswith(head.encode())
    names, sizes = {number: name for name, (number, _) in mesh.field_data.items()}, Counter()
    for tags in mesh.cell_data["gmsh:physical"]:
        sizes.update(names[tag] for tag in tags.tolist())
    assert sizes == FAMILIES | PERIODIC | {"left": 12, "right": 24}
    check_outward(mesh.points, mesh.cells_dict["quad"])
    skin = mesh.cell_data_dict["gmsh:physical"]["quad"] == mesh.field_data["skin"][0]
    assert (mesh.points[mesh.cells_dict["quad"][skin]][..., 2] == 0).all()
    assert (volumes(mesh.points, mesh.cells_dict["hexahedron"]) > 0).all()


def test_fields_blocks_and_families_of_boundary_faces(tmp_path):
    mesh = export(with_families(), tmp_path / "a.vtu", boundary="true")
    assert [block.type for block in mesh.cells] == ["hexahedron", "quad"]
    inside, family = mesh.cell_data["family"]
    assert (inside == 0).all()
    names = list(FAMILIES | PERIODIC)
    assert np.bincount(family)[1:].tolist() == list((FAMILIES | PERIODIC).values())
    for number, name in enumerate(names, start=1):
        np.testing.assert_array_equal(mesh.cell_data[f"family {name}"][1] == 1, family == number)
    np.testing.assert_array_equal(mesh.point_data["x"], mesh.points[:, 0])
    np.testing.assert_allclose(mesh.cell_data["centre"][0], mesh.points[mesh.cells[0].data].mean(axis=1), atol=1e-15)
    assert np.isnan(mesh.cell_data["centre"][1]).all()
    for name in ("block", "small"):
        np.testing.assert_array_equal(mesh.cell_data[name][0], np.repeat([0, 1], [12, 24]))
    assert (mesh.cell_data["block"][1] == -1).all()
    assert list(mesh.point_data) == ["x"]
    lack = ".vtu files cannot hold the 3 patches of the grid; add the outside faces with their families by --variant"
    lost = ".vtu files cannot hold these data of the grid, which are not written: mixed, flag"
    for options in (None, {"boundary": "false"}, {"boundary": True}):
        notes = complete_for_export(with_families(), tmp_path / "a.vtu", options).notes
        assert notes == ((lost,) if options == {"boundary": True} else (lost, f"{lack} boundary=true"))


def test_points_are_numbered_as_documented(tmp_path):
    """Nodes on block faces in the order of the blocks, each where it comes first; then the others."""
    grid = two_blocks()
    mesh = export(grid, tmp_path / "a.su2")
    on_face, inside, seen = [], [], set()
    for b in range(grid.n_blocks):
        for ijk in np.ndindex(grid.shapes[b]):
            point = tuple(grid.block(b)[ijk].tolist())
            outer = any(n in (0, size - 1) for n, size in zip(ijk, grid.shapes[b], strict=True))
            if outer and point not in seen:
                on_face.append(point)
            seen.add(point)
            if not outer:
                inside.append(point)
    np.testing.assert_array_equal(mesh.points, on_face + inside)
