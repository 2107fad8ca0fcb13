"""Grids: what is refused, how places are called, end planes, what is wrong with connections."""

import dataclasses
import re

import numpy as np
import pytest
from grids import block_around

from meshdeform_core.errors import GridError
from meshdeform_core.grid import Connection, Field, FileFormat, Grid, Side, Window
from meshdeform_core.grid.blocks import rounded
from meshdeform_core.grid.connections import check_connections, periodic_image
from meshdeform_core.grid.parts import Periodicity
from meshdeform_core.grid.planes import plane_axes, plane_normal
from meshdeform_core.grid.selection import BY_PREFIX, with_components
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.grid.windows import end_planes

CUBE = block_around(*[np.linspace(0.0, 1.0, 3)] * 3)
ONE = Grid.from_blocks([CUBE])


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda: Grid.from_blocks([]), "the grid has no blocks; expected at least one"),
        (lambda: Grid.from_blocks([CUBE] * 2, "aa"), "need one unique name per block, found ['a', 'a'] for 2 blocks"),
        (lambda: Grid.from_blocks([CUBE] * 2, "a"), "need one unique name per block, found ['a'] for 2 blocks"),
        (lambda: Grid.from_blocks([CUBE, CUBE[:1, :, :1]]), "block2: (1, 3, 1) nodes is not a block; expected"),
        (lambda: Grid.from_blocks([CUBE[:0]]), "block1: (0, 3, 3) nodes is not a block; expected at least 2 nodes"),
        (lambda: Grid.from_blocks([CUBE, CUBE[:1]]), "(block2 is one plane of nodes, block1 is not)"),
        (lambda: ONE.moved(np.zeros((5, 3))), "is (5, 3) float64; blocks ((3, 3, 3),) need (27, 3) float64"),
        (lambda: ONE.moved(np.zeros((27, 3), "f4")), "coordinate array is (27, 3) float32; blocks"),
        (lambda: plane_normal(Grid.from_blocks([np.sin(CUBE[:1] @ [[1, 0, 0], [2, 1, 0], [0, 0, 1]])])),
         "one layer of nodes but not a plane; surface grids cannot be deformed"),
    ],
)  # fmt: skip
def test_what_is_no_grid_is_refused(work, message):
    with pytest.raises(GridError, match=re.escape(message)):
        work()


def test_places_have_names():
    grid = Grid.from_blocks([CUBE, CUBE[:, :2]], ["a", "wing"])
    assert list(map(grid.node_label, (26, 27, 27 + 11))) == ["a (3, 3, 3)", "wing (1, 1, 1)", "wing (2, 2, 3)"]
    assert grid.window_label(Window(1, Side.KMAX, (0, 0), (2, 1))) == "wing.kmax"
    assert grid.window_label(Window(1, Side.JMIN, (0, 1), (2, 2))) == "wing.jmin[1:3,2:3]"
    named = Grid.from_blocks([CUBE] * 4, ["1", "wing.01", "wing-2", "a 3b"])
    found = with_components(named, BY_PREFIX)
    assert (found.components, found.component_numbers.tolist()) == (("1", "wing", "wing", "a 3b"), [0, 1, 1, 2])
    turned = periodic_image(np.array([[0.0, 1.0, 0.0]]), Periodicity(rotation_angle=(90.0, 0.0, 90.0)))
    np.testing.assert_allclose(turned, [[0.0, 0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(np.cross(*plane_axes(np.array([0.6, 0.0, -0.8]))), [0.6, 0.0, -0.8])
    np.testing.assert_array_equal(grid.sample(9), grid.points[::5])
    assert [each.n_face_nodes for each in (ONE, grid, Grid.from_blocks([CUBE[:, :1]]))] == [26, 26 + 18, 9]
    np.testing.assert_array_equal(rounded(grid.points / 3, "float32"), (grid.points / 3).astype("f4").astype("f8"))
    # Out of a far side into a near one the index of the other block increases.
    assert [Side.IMAX.into(side) for side in Side] == [1, -1, 2, -2, 3, -3]
    formats = FileFormat("plot3d", "float32", {"encoding": "Fortran", "iblank": False}), FileFormat("cgns")
    assert [each.label for each in formats] == ["plot3d (encoding=Fortran, iblank=false), float32", "cgns, float64"]
    named = [Field(name, place, 0, CUBE) for name, place in (("IBlank", "node"), ("IBLANK", "cell"), ("p", "node"))]
    assert [each.blanks for each in named] == [True, False, False]


def test_the_ends_of_one_layer_are_those_of_neighbours_where_a_block_leaves_them_open():
    """A plate with a strip that is one cell wide and thick, too, of one block or of two."""
    line, thin = np.linspace(0.0, 1.0, 5), np.array([0.0, 0.1])
    plate = block_around(line, line, thin)
    strips = [block_around(thin * 2.5, n + line, thin) for n in (1, 2)]
    found = [end_planes(grid, find_topology(grid)) for grid in map(Grid.from_blocks, (
        [plate], [*strips, plate], [plate, strips[1]], strips[:1], [plate, ONE.block(0) + 5.0]))]  # fmt: skip
    assert found == [[4, 5], [4, 5, 10, 11, 16, 17], [], [], []]


def test_what_is_wrong_with_a_connection_is_told_with_its_size():
    """The first cells of the second block are thin at one end of the common face, and its ratios are largest there."""
    line = np.array([0.0, 0.25, 1.0])
    one, thin = (block_around(x, line, CUBE[0, 0, :, 2]) for x in (line, CUBE[:, 0, 0, 0]))
    thin[..., 0] *= 0.1 + thin[..., 1]
    grid = Grid.from_blocks([one, thin + [1.0, 0.0, 0.0]], ["a", "b"])
    ends = (2, 0, 0), (2, 2, 2)
    face = Connection("c", 0, *ends, 1, (0, 0, 0), (0, 2, 2), (1, 2, 3))
    turned = Periodicity((1.0, 1.0, 0.0), (0.0, 0.0, -90.0), (0.0, -1.0, 0.0024))
    fits = Connection("p", 0, (0, 0, 0), (0, 2, 2), 0, (0, 2, 0), (2, 2, 2), (2, 1, 3), turned)
    low = dataclasses.replace(fits, periodic=dataclasses.replace(turned, translation=(0.0, -1.0, 0.0026)))
    itself = dataclasses.replace(face, donor_block=0, donor_begin=ends[0], donor_end=ends[1])
    shifted = dataclasses.replace(face, begin=(2, 1, 0), donor_end=(0, 1, 2))
    back = Connection("d", 1, (0, 0, 0), (0, 1, 2), 0, (2, 1, 0), (2, 2, 2), (1, 2, 3))
    beyond = dataclasses.replace(face, end=(2, 2, 3), donor_end=(0, 2, 3))
    below = dataclasses.replace(face, donor_begin=(0, 1, 2), transform=(1, -2, -3))
    c = "connection 'c' of a"
    undeclared = "8 face quads coincide but no connection declares them (blocks a, b)"
    apart = "6 of 6 node pairs do not coincide (largest gap 0.75, 5 of the local edge)"
    for given, expected in (
        ((face,), []),
        ((face, fits), []),
        ((low,), ["connection 'p' of a with a: 9 of 9 periodic node pairs differ, by up to 0.0026"]),
        ((face, itself), [f"{c} with a: it joins the nodes of one face with themselves and has no effect"]),
        ((shifted,), [f"{c} with b: {apart}"]),
        ((back,), [f"connection 'd' of b with a: {apart}"]),
        ((beyond,), [f"{c}: its range reaches node [3, 3, 4], but a has [3, 3, 3] nodes", undeclared]),
        ((below,), [f"{c}: its donor range reaches node [1, 0, 1], but b has [3, 3, 3] nodes", undeclared]),
    ):
        found = dataclasses.replace(grid, connections=given)
        assert [text.partition("; ")[0] for text in check_connections(found, find_topology(found))] == expected
