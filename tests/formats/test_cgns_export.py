"""New CGNS files from grids of other formats or made in memory, checked by cgnscheck, vtk and our own reader."""

import itertools
import math
from dataclasses import replace

import h5py
import numpy as np
import pytest
from cgns_witness import assert_cgnscheck_finds_no_error, box
from grids import whole_face

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Field, Grid, Patch, Periodicity, Side, Window
from meshdeform_core.grid.connections import periodic_image
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.cgns.boundary import inverse_motion


def two_blocks(**more: object) -> Grid:
    """Two boxes joined along i; the second is turned so that its j axis continues the first one's i axis."""
    turned = box(3, 3, 5, (3, 0, 0)).transpose(1, 0, 2, 3)[::-1]
    joint = Connection("joint", 0, (3, 0, 0), (3, 2, 4), 1, (2, 0, 0), (0, 0, 4), (2, -1, 3))
    wing = Window(0, Side.JMIN, (0, 0), (3, 4)), Window(1, Side.IMAX, (0, 0), (2, 4))
    patches = (
        Patch("wing", wing, bc_type="viscous_solid"),
        Patch("inlet", (Window(0, Side.IMIN, (0, 1), (2, 4)),), "Far", "BCFarfield"),
        Patch("odd", (Window(1, Side.KMAX, (0, 0), (2, 2)),), "", "my condition"),
    )
    grid = Grid.from_blocks([box(4, 3, 5), turned], ["left", "right"], patches=patches, connections=(joint,))
    return replace(grid, **more)


def test_everything_comes_back(tmp_path):
    grid = two_blocks()
    written = write_grid(grid, tmp_path / "new.cgns")
    again = read_grid(tmp_path / "new.cgns")
    assert written.label == "cgns (container=HDF5), float64"
    np.testing.assert_array_equal(again.points, grid.points)
    assert (again.names, again.shapes) == (grid.names, grid.shapes)
    wing, inlet, second_wing, odd = again.patches
    assert wing == Patch("wing", grid.patches[0].windows[:1], "wing", "BCWallViscous")
    assert inlet == grid.patches[1]
    assert second_wing == Patch("wing", grid.patches[0].windows[1:], "wing", "BCWallViscous")
    assert odd == replace(grid.patches[2], bc_type="UserDefined")
    assert again.connections == (
        grid.connections[0],
        Connection("joint", 1, (0, 0, 0), (2, 0, 4), 0, (3, 2, 0), (3, 0, 4), (-2, 1, 3)),
    )
    assert again.notes == ()
    # Both directions are written once.
    write_grid(replace(grid, connections=again.connections), tmp_path / "two.cgns")
    assert read_grid(tmp_path / "two.cgns").connections == again.connections
    # The words of other formats are kept beside those of CGNS.
    with h5py.File(tmp_path / "new.cgns") as file:
        assert file["Base/right/ZoneBC/odd/BoundaryCondition/ data"][()].tobytes() == b"my condition"
        assert file["Base/Far/FamilyBC/ data"][()].tobytes() == b"BCFarfield"
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")


def test_a_connection_given_backwards(tmp_path):
    backwards = Connection("back", 0, (3, 2, 4), (3, 0, 0), 1, (0, 0, 4), (2, 0, 0), (2, -1, 3))
    write_grid(two_blocks(connections=(backwards,)), tmp_path / "new.cgns")
    assert read_grid(tmp_path / "new.cgns").connections[0] == replace(two_blocks().connections[0], name="back")
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")


@pytest.mark.parametrize(
    "periodic",
    [
        Periodicity(translation=(0.0, 0.0, 4.0)),
        Periodicity((0.0, 0.0, 0.0), (0.0, -120.0, 0.0)),
        Periodicity((1.0, 2.0, 3.0), (10.0, 0.0, 30.0), (4.0, 5.0, 6.0)),
        Periodicity((1.0, 2.0, 3.0), (10.0, 20.0, 30.0), (4.0, 5.0, 6.0)),
    ],
)
def test_periodic_connections_and_their_way_back(tmp_path, periodic):
    connection = Connection("per", 0, (0, 0, 0), (3, 2, 0), 0, (0, 0, 4), (3, 2, 4), (1, 2, 3), periodic)
    write_grid(two_blocks(connections=(connection,)), tmp_path / "new.cgns")
    there, back = read_grid(tmp_path / "new.cgns").connections
    assert (back.begin, back.donor_begin) == (there.donor_begin, there.begin)
    for found, wanted in ((there.periodic, periodic), (back.periodic, inverse_motion(periodic))):
        np.testing.assert_allclose(found.rotation_center, wanted.rotation_center, atol=1e-6)
        np.testing.assert_allclose(found.rotation_angle, wanted.rotation_angle, atol=1e-5)
        np.testing.assert_allclose(found.translation, wanted.translation, atol=1e-5)
    points = np.random.default_rng(0).normal(size=(5, 3))
    for motion in (periodic, inverse_motion(periodic)):
        points = periodic_image(points, motion)
    np.testing.assert_allclose(points, np.random.default_rng(0).normal(size=(5, 3)), atol=1e-12)
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")


# Types of fields, their largest values here, and the types in which CGNS holds them.
TYPES = [("?", 1, "i4"), ("i2", 2**15 - 1, "i4"), ("i4", 2**31 - 1, "i4"), ("u4", 2**32 - 1, "i8"), ("i8", 2**62, "i8"),
         ("f2", 9, "f8"), ("f4", 1e30, "f4"), (">f8", 1e300, "f8")]  # fmt: skip
ENDS = {(): [""], (2,): ["X", "Y"], (3,): ["X", "Y", "Z"], (3, 3): [str(n) for n in range(1, 10)]}


@pytest.mark.parametrize(("kind", "largest", "stored"), TYPES)
def test_fields_become_flow_solutions(tmp_path, kind, largest, stored):
    grid = two_blocks()
    places = [("node", 0, (4, 3, 5), "left/FlowSolutionVertex"), ("cell", 1, (2, 2, 4), "right/FlowSolutionCellCenter")]
    fields = {}
    for (location, block, shape, place), rest in itertools.product(places, ENDS):
        values = np.linspace(0, largest, math.prod(shape + rest)).reshape(*shape, *rest).astype(kind)
        fields[place, rest] = Field(f"f{len(rest)}{sum(rest)}", location, block, values)
    write_grid(replace(grid, fields=tuple(fields.values())), tmp_path / "new.cgns")
    with h5py.File(tmp_path / "new.cgns") as file:
        for (place, rest), field in fields.items():
            assert place.endswith(file[f"Base/{place}/GridLocation/ data"][()].tobytes().decode())
            for number, end in enumerate(ENDS[rest]):
                found = file[f"Base/{place}/{field.name}{end}/ data"]
                assert found.dtype == stored
                wanted = field.values.reshape(*field.values.shape[:3], -1)[..., number]
                np.testing.assert_array_equal(found[()].T, wanted)
        assert list(file["Base/left"])[3:] == ["FlowSolutionVertex", "ZoneBC", "ZoneGridConnectivity"]
    np.testing.assert_array_equal(read_grid(tmp_path / "new.cgns").points, grid.points)
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")


@pytest.mark.parametrize("source", ["new", "copy"])
@pytest.mark.parametrize(("location", "shape"), [("node", (5, 4, 2)), ("cell", (5, 4, 3)), ("jface", (4, 3, 2))])
def test_fields_of_another_shape_are_refused(location, shape, source, tmp_path):
    grid = Grid.from_blocks([box(5, 4, 3)], ["only"])
    if source == "copy":
        write_grid(grid, tmp_path / "grid.cgns")
        grid = read_grid(tmp_path / "grid.cgns")
    wrong = replace(grid, fields=(Field("w", location, 0, np.ones(shape)),))
    with pytest.raises(FormatError, match=rf"{location} field 'w' of only has shape .*; expected \([45], [34], [23]\)"):
        write_grid(wrong, tmp_path / "out.cgns")
    assert not (tmp_path / "out.cgns").exists()


@pytest.mark.parametrize("flat", [0, 1, 2])
@pytest.mark.parametrize("in_plane", [True, False])
def test_two_dimensional_grids(tmp_path, flat, in_plane):
    """The axis of a single node disappears, whichever it is."""
    plane = box(4, 3, 1)[:, :, 0]
    plane[..., 2] = 0.0 if in_plane else -(plane[..., 0] ** 2)
    block = np.expand_dims(plane, flat)
    kept = [axis for axis in range(3) if axis != flat]
    side = Side(2 * kept[0] + 1)
    values = np.arange(12.0).reshape(np.expand_dims(plane[..., 0], flat).shape)
    end, donor_end = [0, 0, 0], [0, 0, 0]
    end[kept[1]] = donor_end[kept[1]] = 2
    end[kept[0]] = 3
    begin = [3 if axis == kept[0] else 0 for axis in range(3)]
    grid = Grid.from_blocks(
        [block],
        patches=(
            Patch("out", (whole_face(block.shape[:3], 0, side),)),
            Patch("plane", (whole_face(block.shape[:3], 0, Side(2 * flat)),)),
        ),
        connections=(Connection("c", 0, tuple(begin), tuple(end), 0, (0, 0, 0), tuple(donor_end), (1, 2, 3)),),
        fields=(Field("v", "node", 0, values),),
    )
    write_grid(grid, tmp_path / "new.cgns")
    again = read_grid(tmp_path / "new.cgns")
    assert (again.shapes, again.notes) == (((4, 3, 1),), ())
    np.testing.assert_array_equal(again.block(0)[:, :, 0], plane)
    (out,) = again.patches
    assert (out.name, out.windows) == ("out", (Window(0, Side.IMAX, (0, 0), (2, 0)),))
    assert again.connections[0] == Connection("c", 0, (3, 0, 0), (3, 2, 0), 0, (0, 0, 0), (0, 2, 0), (1, 2, 3))
    with h5py.File(tmp_path / "new.cgns") as file:
        assert file["Base/ data"][()].tolist() == [2, 2 if in_plane else 3]
        assert list(file["Base/block1/ZoneBC/out"]) == [" data", "PointRange"]
        np.testing.assert_array_equal(file["Base/block1/FlowSolutionVertex/v/ data"][()].T, values.squeeze())
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")


def test_long_and_repeated_names(tmp_path):
    long = "a very long name of a block that goes on"
    names = [f"{long} {b}" for b in range(3)]
    patches = tuple(Patch(f"{long}/{b % 2}", (whole_face((3, 3, 3), 0, Side(b)),), f"{long}{b % 2}") for b in range(4))
    grid = Grid.from_blocks([box(3, 3, 3)] * 3, names, patches=patches)
    write_grid(grid, tmp_path / "new.cgns")
    again = read_grid(tmp_path / "new.cgns")
    assert len(set(again.names)) == 3
    assert len({patch.name for patch in again.patches}) == 4
    assert len({patch.family for patch in again.patches}) == 2
    assert all(len(name) <= 32 for name in again.names)
    assert_cgnscheck_finds_no_error(tmp_path / "new.cgns")
