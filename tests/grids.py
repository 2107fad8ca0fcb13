"""Small grids made for tests."""

import dataclasses
import itertools

import numpy as np

from meshdeform_core.grid import Connection, Grid, Patch, Shape, Side, Window
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.grid.windows import windows_of_quads

CASE = """\
[constants]
turn = 10.0

[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
kind = "moving"
motion = [{ rotate = { angle = "turn", axis = [0, 0, 1], center = [0, 0, 0] } }]

[[boundary]]
name = "span"
select = ["*.kmin", "*.kmax"]
kind = "slip"

[[boundary]]
name = "outer"
select = ["*.i*", "*.j*"]
where = "max(abs(x), abs(y)) > 1.99"
kind = "fixed"
"""
"""The body of ``frame`` turns between slip planes, inside a fixed outer boundary."""
LINE = np.linspace(0.0, 1.0, 5)
SPANS = ((-2.0, -0.5), (-0.5, 0.5), (0.5, 2.0))


def stretched(span: tuple[float, float], cells: int) -> np.ndarray:
    """Nodes that are closer together at the lower end."""
    s = np.linspace(0.0, 1.0, cells + 1)
    return span[0] + (span[1] - span[0]) * (0.6 * s + 0.4 * s**2)


def block_around(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)


def frame(cells: int = 4, layers: int = 3) -> Grid:
    """Eight Cartesian blocks around a square bar: every kind of interface, clustered, right-handed."""
    lines = [stretched(span, cells + n) for n, span in enumerate(SPANS)]
    z = np.linspace(0.0, 1.0, layers + 1)
    blocks = [block_around(lines[i], lines[j], z) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return Grid.from_blocks(blocks)


def frame_2d(cells: int = 5) -> Grid:
    """The same in two dimensions."""
    return frame(cells, 0)


def polar(n_around: int = 24, n_radial: int = 8, n_span: int = 4) -> Grid:
    """One O-grid block around a cylinder: a seam, curved walls."""
    angle = np.linspace(0.0, 2 * np.pi, n_around + 1)
    radius = stretched((1.0, 3.0), n_radial)
    z = np.linspace(0.0, 1.0, n_span + 1)
    a, r, h = np.meshgrid(angle, radius, z, indexing="ij")
    x = np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)
    x[-1] = x[0]
    return Grid.from_blocks([x[:, :, ::-1].copy()])


def cut_behind_a_body() -> Grid:
    """A C-grid of one block, one side of which is folded onto itself behind a body."""
    s, t, z = np.meshgrid(np.linspace(-2.0, 2.0, 9), LINE, LINE, indexing="ij")
    t += 0.5 * np.maximum(1.0 - np.abs(s), 0.0)
    return Grid.from_blocks([np.stack([s * s - t * t, 2.0 * s * t, z], axis=-1)])


def discs() -> Grid:
    """Two discs, one on the other, with triangles around the axis and other directions of indices."""
    a, r, z = np.meshgrid(2.0 * np.pi * LINE, LINE, LINE, indexing="ij")
    low = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)
    return Grid.from_blocks([low, turn_block(low + [0.0, 0.0, 1.0], (1, 0, 2), (True, False, True))])


def prisms() -> Grid:
    """Two prisms with a common triangle, of which each repeats another corner."""
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    low, top = (np.roll(triangle, n, axis=0)[[[0, 0], [1, 2]]] for n in (0, 1))
    return Grid.from_blocks([np.stack([x + [0, 0, z], x + [0, 0, z + 1]], axis=2) for z, x in enumerate((low, top))])


def turn_block(x: np.ndarray, axes: tuple[int, ...], flips: tuple[bool, ...]) -> np.ndarray:
    """A block (ni, nj, nk, 3) with permuted, then flipped indices."""
    return np.ascontiguousarray(np.flip(np.transpose(x, (*axes, 3)), [a for a in range(3) if flips[a]]))


def turn_back(x: np.ndarray, axes: tuple[int, ...], flips: tuple[bool, ...]) -> np.ndarray:
    """Undo :func:`turn_block`."""
    return np.transpose(np.flip(x, [a for a in range(3) if flips[a]]), (*np.argsort(axes), 3))


def permuted(grid: Grid, axes: tuple[int, int, int], flips: tuple[bool, bool, bool]) -> Grid:
    """Every block with its index axes permuted and flipped."""
    return Grid.from_blocks([turn_block(grid.block(b), axes, flips) for b in range(grid.n_blocks)], grid.names)


def whole_face(shape: Shape, block: int, side: Side) -> Window:
    """The window that covers a whole block face."""
    a, b = side.tangential
    return Window(block, side, (0, 0), (shape[a] - 1, shape[b] - 1))


def transform_matrix(connection: Connection) -> np.ndarray:
    """(3, 3) steps of the donor's indices for those of a connection."""
    matrix = np.zeros((3, 3), int)
    for axis, donor in enumerate(connection.transform):
        matrix[abs(donor) - 1, axis] = np.sign(donor)
    return matrix


def joined_nodes(grid: Grid, connection: Connection) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (n, 3) of a connection's nodes and of their donors, by the definition of the transform."""
    begin, end = np.array(connection.begin), np.array(connection.end)
    steps = np.indices(np.abs(end - begin) + 1).reshape(3, -1).T * np.where(end >= begin, 1, -1)
    here, there = begin + steps, np.array(connection.donor_begin) + steps @ transform_matrix(connection).T
    assert tuple(there[-1]) == connection.donor_end
    assert min(here.min(), there.min()) >= 0
    return grid.block(connection.block)[tuple(here.T)], grid.block(connection.donor_block)[tuple(there.T)]


def clustered(start: float, end: float, cells: int, strength: float) -> np.ndarray:
    """Nodes whose spacing grows exponentially from ``start``."""
    return start + (end - start) * np.expm1(strength * np.linspace(0.0, 1.0, cells + 1)) / np.expm1(strength)


def plenum() -> Grid:
    """A square duct, -10 < x < 0 and 2 wide, that ends in the wall of a large box, x > 0 and 200 wide."""
    half = clustered(0, 1, 4, 2.0)
    duct = np.concatenate([half - 1, (1 - half)[::-1][1:]])
    across = clustered(-1, -100, 8, 6.0)[::-1], duct, clustered(1, 100, 8, 6.0)
    downstream = clustered(0, 200, 10, 6.0)
    room = [block_around(downstream, *lines) for lines in itertools.product(across, across)]
    return Grid.from_blocks([block_around(np.linspace(-10, 0, 11), duct, duct), *room])


def with_walls(grid: Grid) -> Grid:
    """``frame`` with the patches ``body``, ``outer`` and ``span``."""
    topology = find_topology(grid)
    windows: dict[str, list] = {"body": [], "outer": [], "span": []}
    for block in range(grid.n_blocks):
        for side in Side:
            chosen = topology.external[topology.quads.of_side(block, side)]
            low = grid.points[topology.first[topology.quads.corners[topology.quads.of_side(block, side)]]]
            near = np.abs(low[..., :2]).max() < 0.51
            name = "span" if side.axis == 2 else "body" if near else "outer"
            counts = tuple(topology.quads.counts[block, side])
            windows[name] += windows_of_quads(grid.shapes[block], block, side, chosen.reshape(counts))
    kinds = {"body": "BCWall", "outer": "BCFarfield", "span": "BCSymmetryPlane"}
    patches = tuple(Patch(name, tuple(found), name, kinds[name]) for name, found in windows.items())
    return dataclasses.replace(grid, patches=patches)


def waved(grid: Grid) -> Grid:
    """The grid with all nodes moved by a smooth function."""
    x = grid.points
    shift = 0.05 * np.sin(2 * x[:, [1, 2, 0]] + x)
    return grid.moved(x + shift * (np.ptp(x, axis=0) > 0))


def tapered(*size: int) -> Grid:
    """A frame that narrows along z, so that it is no extrusion."""
    grid = frame(*size)
    return grid.moved(grid.points * (1.0 - 0.2 * grid.points[:, 2:]) ** np.array([1.0, 1.0, 0.0]))


def interleaved(**grids: Grid) -> Grid:
    """All blocks in one grid, named ``NAME.NUMBER``, those of different grids in turn."""
    most = max(grid.n_blocks for grid in grids.values())
    places = [(name, n) for n in range(most) for name, grid in grids.items() if n < grid.n_blocks]
    return Grid.from_blocks([grids[name].block(n) for name, n in places], [f"{name}.{n + 1}" for name, n in places])
