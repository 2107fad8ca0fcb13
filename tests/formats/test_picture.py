"""What pictures show: polygons against geometry, choices for every sample, colours that tell."""

import io

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, plenum, polar
from PIL import Image

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.faces import Role
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality.cells import measure_block
from meshdeform_core.quality.fields import CELL_MEASURES
from meshdeform_formats.picture import overview, scene
from meshdeform_formats.picture.page import INVALID_COLOUR, Page, Panel, Scale, page_bytes
from meshdeform_formats.picture.raster import render
from meshdeform_formats.picture.subject import Subject, worst_cell
from meshdeform_samples import load


def subject(grid, reference=None):
    return Subject(grid, find_topology(reference or grid), reference)


def scale_of(metric, values, limits=None, logarithmic=False):
    return Scale(metric, limits, logarithmic).fitted(values)


def area(corners):
    """Of polygons (n, m, 3), by the sum of cross products."""
    arms = corners - corners[:, :1]
    return 0.5 * np.linalg.norm(np.cross(arms[:, :-1], arms[:, 1:]).sum(axis=1), axis=1)


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 2, 3), (-3, 0.2, 0.7)])
def test_a_cut_has_the_area_of_the_cross_section(normal):
    grid = Grid.from_blocks([block_around(*(np.linspace(-1.0, 1.0, 7) ** 3 for _ in range(3)))])
    unit = np.array(normal) / np.linalg.norm(normal)
    facets = scene.cut_facets(subject(grid), Plane(np.array([0.11, -0.07, 0.05]), unit), "f_skew")
    level = (facets.corners - [0.11, -0.07, 0.05]) @ unit
    assert np.abs(level).max() < 1e-7
    # Cavalieri: the area is the derivative of the volume on one side, which a fine sample of the cube gives.
    n, h = 100, 0.1
    axis = (np.arange(n) + 0.5) / n * 2 - 1
    samples = (axis[:, None, None] * unit[0] + axis[:, None] * unit[1] + axis * unit[2]) - unit @ [0.11, -0.07, 0.05]
    expected = float((np.abs(samples) < h / 2).mean()) * 8 / h
    assert area(facets.corners).sum() == pytest.approx(expected, rel=5e-2)


def test_cuts_planes_and_surfaces_show_the_cells_there():
    s = subject(frame())
    for z in (0.0, 0.4, 1.0):
        facets = scene.cut_facets(s, Plane(np.array([0, 0, z]), np.array([0.0, 0.0, 1.0])), "volume")
        assert area(facets.corners).sum() == pytest.approx(15.0)
        volumes = np.concatenate([measure_block(s.grid.block(b), 1.0, None).volume.ravel() for b in range(8)])
        assert np.isin(facets.values, volumes).all()
    with pytest.raises(CaseError, match=r"no part of the grid lies at z = 1\.5"):
        scene.cut_facets(s, Plane(np.array([0, 0, 1.5]), np.array([0.0, 0.0, 1.0])), "volume")
    # Surfaces and planes have the values of the cells behind.
    volume = measure_block(s.grid.block(0), 1.0, None).volume
    values = scene.layer_facets(s, scene.index_layers(s.grid, 2, 3), "volume").values
    np.testing.assert_allclose(values[: volume[:, :, -1].size], volume[:, :, -1].ravel())
    quads = np.arange(*s.topology.quads.of_side(0, 1).indices(10**9)[:2])
    np.testing.assert_allclose(scene.layer_facets(s, scene.face_layers(s, quads), "volume").values, volume[-1].ravel())


def test_walls_in_space_before_a_symmetry_plane_and_a_cut():
    s = subject(load("wing").generate(8))
    solid, cut = overview.overview(s, Scale()).panels[:2]
    assert solid.scene.lit
    assert not solid.scene.view.flat
    assert cut.scene.view.flat
    assert cut.title.startswith("cut ")
    (mirror,) = s.outside.of_role(Role.SYMMETRY)
    assert s.outward(mirror) @ solid.scene.view.towards < 0
    # Moved walls are coloured by their motion.
    new = subject(s.grid.moved(s.grid.points + [0.0, 0.0, 0.25]), s.grid)
    page = overview.moved_walls(s, new, np.concatenate([w.quads for w in s.outside.of_role(Role.WALL)]))
    np.testing.assert_allclose(page.panels[0].scene.facets.values, 0.25)


@pytest.mark.parametrize("grid", [frame(), frame_2d(), polar(), load("splitter-plate").generate(8)])
def test_flat_and_extruded_grids_from_above(grid):
    page = overview.overview(subject(grid), Scale())
    assert page.panels
    assert all(panel.scene.view.flat and panel.scene.view.labels == ("x", "y") for panel in page.panels)


def test_a_small_body_has_a_close_up():
    whole, near = overview.overview(subject(load("airfoil").generate(41)), Scale()).panels[:2]
    assert near.window.width < 2.5 < whole.window.width
    assert (whole.title, near.title, near.aspect) == ("whole grid", "close-up", pytest.approx(0.5))


@pytest.mark.parametrize("metric", CELL_MEASURES)
def test_the_worst_cell_of_each_measure(metric):
    """Smallest, largest or farthest from one, as its definition says, of a grid and of its mirror image."""
    grid = frame(2, 2)
    wave = 0.03 * np.sin(grid.points @ [[2.0, 1.0, 0.5], [1.0, -2.0, 0.0], [0.0, 1.0, -1.0]])
    badness = {"small": lambda v: v, "large": lambda v: -v, "far": lambda v: -np.abs(np.log(v))}
    for points in (grid.points + wave, grid.points - wave):
        s = subject(grid.moved(points), grid)
        block, cell = worst_cell(s, metric)
        found = [badness[CELL_MEASURES[metric].worst](s.values(metric, b, s.whole(b))) for b in range(8)]
        assert found[block][cell] == np.nanmin(np.concatenate([values.ravel() for values in found]))


WRONG = {
    "plane": ("a plane of nodes, like k=1 or k=mid, or one in space, like z=0.25", "k=0", "k=1.5", "z=", "w=1"),
    "view": ("auto, x, y, z, iso or a direction like 1,-1,0.5", "0,0,0", "1,2", "1,2,inf", "w"),
    "range": ("low,high with low < high", "1,1", "2,1", "0,inf", "1"),
    "zoom": ("worst, walls or left,right,bottom,top with left < right, bottom < top", "0,1,2", "1,0,0,1", "0,1,1,1"),
}  # fmt: skip
WRONG_OPTIONS = [
    ({"plane": "k=1", "select": ("a",)}, "--plane and --select exclude each other; give one of them"),
    *(({"limits" if name == "range" else name: value}, f"--{name} {value!r}: expected {expected}")
      for name, (expected, *values) in WRONG.items() for value in values),
    *(({"plane": "k=1", "zoom": zoom}, f"--zoom {zoom!r} shows nothing of the grid, which extends from -2 to 2 and "
       "from -2 to 2 in the picture") for zoom in ("2,3,0,1", "-3,-2,0,1", "0,1,2,3", "0,1,-3,-2")),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), WRONG_OPTIONS)
def test_options_that_are_refused(options, message):
    with pytest.raises(CaseError) as error:
        overview.picture(subject(frame()), overview.PlotOptions(**options, lead="--"))
    assert str(error.value) == message


def covered(panel):
    """The part of a panel in which something other than backdrop is drawn: all that is red."""
    colours = np.tile([1.0, 0.0, 0.0], (len(panel.scene.facets), 1))
    pixels = render(panel.scene, colours, panel.window, 100).astype(int)
    return (pixels[..., 0] > pixels[..., 1] + 50).mean()


def test_a_duct_fills_the_picture_and_the_wall_that_it_ends_in_is_behind_it():
    s = subject(plenum())
    (solid, *_) = overview.overview(s, Scale()).panels
    assert {body.name for body in s.outside.bodies} == {f"block1.{side}" for side in ("jmin", "jmax", "kmin", "kmax")}
    assert covered(solid) > 0.2
    assert solid.scene.view.towards[0] < 0


def test_invalid_cells_have_their_own_colour_and_are_counted():
    grid = frame()
    points = grid.points * [1.0, 1.0, 1.2]
    grid.block(0, points)[2, 2, 2] += [0.0, 0.0, 0.9]
    broken = subject(grid.moved(points), grid)
    facets = scene.layer_facets(broken, scene.index_layers(grid, 2, 2), "f_skew")
    assert facets.bad.any()
    colours = Scale().fitted(facets.values).colours(facets)
    assert (colours[facets.bad] == INVALID_COLOUR).all()
    assert not (np.abs(colours[~facets.bad] - INVALID_COLOUR).max(axis=1) < 0.05).any()
    block, cell = worst_cell(broken, "f_skew")
    assert block == 0
    assert broken.bad(0, broken.whole(0))[cell]


def test_collapsed_edges_alone_are_not_invalid():
    grid = polar()
    points = grid.points.copy()
    points[:, :2] *= (np.hypot(*grid.points[:, :2].T) > 1.0 + 1e-9)[:, None]
    s = subject(grid.moved(points))
    assert not s.bad(0, s.whole(0)).any()
    # f_skew, which is zero there, says nothing of them; the legend explains their colour.
    page = overview.overview(s, Scale())
    assert page.explained == {"absent"}
    assert page.scale.limits[0] > 0.9
    assert worst_cell(s, "f_skew")[1][1] > 0


def test_ranges_follow_the_data():
    values = np.array([0.87, 0.93, 0.99])
    assert Scale().fitted(values).limits == (0.8, 1.0)
    assert [scale_of("f_skew", 1 - n * values).limits[0] for n in (0.0, 0.005, 0.01, 0.05)] == [0.99, 0.99, 0.99, 0.95]
    assert scale_of("volume", values).limits == (0.87, 0.99)
    assert scale_of("volume_ratio", np.array([0.5, 1.2])).limits == (0.5, 1.5)
    for ends, limits in (((0.5, 4.0), (0.25, 4.0)), ((0.5, 1.2), (0.5, 2.0))):
        assert scale_of("volume_ratio", np.array(ends), logarithmic=True).limits == limits
    given = {(0.9, 2.0): "min", (0.0, 0.9): "max", (0.9, 0.95): "both", (0.0, 2.0): "neither"}
    assert {ends: scale_of("volume", values, ends).extended for ends in given} == given
    shades = [float(scale_of("volume", np.full(2, one)).mappable.norm(one)) for one in (1.0, 0.0, -3.0)]
    assert shades == pytest.approx([0.5, 0.5, 0.5])
    with pytest.raises(CaseError, match="no positive value"):
        scale_of("displacement", np.zeros(3), logarithmic=True)


def test_an_image_shows_the_near_side_of_a_cube():
    grid = Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 3),) * 3)])
    s = subject(grid)
    facets = scene.layer_facets(s, scene.face_layers(s, np.arange(24)), "volume")
    for each in (scene.along("x"), scene.along("y"), scene.along("z"), scene.iso()):
        np.testing.assert_allclose(np.cross(each.right, each.up), each.towards, atol=1e-15)
    view = scene.towards(np.array([1.0, -2.0, 1.5]))
    colours = (np.arange(24)[:, None] // 4 * 20 + 100) * [1, 0, 0] / 255
    image = render(scene.Scene(facets, view), colours, view.window(facets.corners), 120)
    seen = [(image[..., :3] == np.rint(255 * colours[4 * side])).all(axis=-1).mean() > 0.02 for side in range(6)]
    assert np.flatnonzero(seen).tolist() == [1, 2, 5]
    assert 0.3 < (image[..., 2] == 0).mean() < 0.95


@pytest.mark.parametrize(("axis", "corner"), [(0, (0, 0)), (0, (1, 1)), (1, (0, 1)), (1, (1, 0)), (2, (1, 1))])
def test_a_cell_is_shown_in_the_plane_in_which_it_folds(axis, corner):
    """Whichever corner of its quadrilateral crosses the opposite diagonal."""
    line = np.array([0.0, 1.0])
    grid = Grid.from_blocks([np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)])
    points = grid.points.copy()
    at = list(corner)
    at.insert(axis, 0)
    inwards = np.where(np.array(at) == 0, 0.8, -0.8)
    inwards[axis] = 0.0
    grid.block(0, points)[tuple(at)] += inwards
    found, normal = overview.telling_plane(grid, grid.moved(points), 0, (0, 0, 0))
    assert found == axis
    np.testing.assert_array_equal(np.abs(normal), np.eye(3)[axis])


def test_pages_before_and_after_have_one_size_and_scale():
    before = frame()
    after = before.moved(before.points + 0.3 * np.sin(before.points[:, [1, 0, 0]]) * [1, 1, 0])
    both = subject(before), subject(after, before)
    page = overview.quality_planes(*both)
    assert page.panels[0].window == page.panels[1].window == overview.quality_planes(*both[::-1]).panels[0].window
    one, other = (page_bytes(each) for each in (page, overview.worst_cells(*both, 2, (1, 1, 1))))
    assert all(png.startswith(b"\x89PNG") for png in (one, other))
    assert page_bytes(page) == one


def test_invalid_cells_are_seen_over_their_neighbours():
    """A cell turned inside out covers its neighbour, at the same depth: it is the one to be seen."""
    quad = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    corners = np.stack([quad[::-1], quad])
    for bad in ((True, False), (False, True)):
        facets = scene.Facets(corners, np.ones(2), np.array(bad))
        colours = np.where(np.array(bad)[:, None], INVALID_COLOUR, (1.0, 1.0, 0.0))
        image = render(scene.Scene(facets, scene.along("z")), colours, scene.Window(0.0, 1.0, 0.0, 1.0), 20)
        np.testing.assert_allclose(image[10, 10, :3] / 255, INVALID_COLOUR, atol=0.02)


def test_thin_invalid_cells_have_edges_of_their_colour():
    """Thinner than a pixel, they would not be seen at all."""
    thin = np.array([[[0, 0.5, 0], [1, 0.5, 0], [1, 0.5001, 0], [0, 0.5001, 0]]])
    facets = scene.Facets(thin, np.zeros(1), np.ones(1, dtype=bool))
    panel = Panel(scene.Scene(facets, scene.along("z")), scene.Window(0.0, 1.0, 0.0, 1.0))
    with Image.open(io.BytesIO(page_bytes(Page.of([panel], Scale())))) as png:
        pixels = np.asarray(png.convert("RGB")) / 255
    assert (np.abs(pixels - INVALID_COLOUR).max(axis=-1) < 0.3).sum() > 40


def test_pictures_show_what_their_options_name():
    """Of a frame whose z goes from 0 to 1 in three layers."""
    s = subject(frame())

    def shown(**options):
        page = overview.picture(s, overview.PlotOptions(**options), "title")
        assert page.title == "title"
        corners = page.panels[0].scene.facets.corners
        return page, corners.min(axis=(0, 1)), corners.max(axis=(0, 1))

    planes = {"k=2": (2, 1 / 3), "k=mid": (2, 1 / 3), "z=0.4": (2, 0.4), "y=1": (1, 1.0), "x=-1": (0, -1.0)}
    for plane, (axis, place) in planes.items():
        page, low, high = shown(plane=plane)
        assert (low[axis], high[axis]) == pytest.approx((place, place))
        others = [n for n in range(3) if n != axis]
        np.testing.assert_allclose(np.stack([low, high])[:, others], np.array([[-2, -2, 0], [2, 2, 1]])[:, others])
        assert abs(page.panels[0].scene.view.towards[axis]) == 1
    page, low, high = shown(select=("block1.imin", "block1.kmax"), view="0,0,1")
    np.testing.assert_allclose([low, high], [[-2, -2, 0], [-0.5, -0.5, 1]], atol=1e-6)
    page, *_ = shown(plane="k=1", zoom="walls")
    assert page.panels[0].window.left > -1
    assert shown(plane="k=1", zoom=(0, 1, 0.5, 0.75))[0].panels[0].window == scene.Window(0, 1, 0.5, 0.75)
    (worst,) = shown(zoom="worst", metric="volume")[0].panels
    block, cell = worst_cell(s, "volume")
    assert worst.title == f"worst cell: {s.grid.label(block, cell)}"
