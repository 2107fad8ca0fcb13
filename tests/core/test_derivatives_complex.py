"""Derivatives of several steps of RBF, TFI and a hybrid against complex steps through a plain twin of these methods.

Later steps depend on the grid in arc lengths, distances, systems and affine maps, of which the twin shares no line with
the loops. A complex step (Squire and Trapp, SIAM Rev. 40, 110, 1998) has no truncation and no cancellation error.
"""

import itertools

import numpy as np
import pytest
from cases import everything_moves, problem_of

from meshdeform_core.grid import Grid
from meshdeform_core.methods import TFI, Options, make_method
from meshdeform_core.methods.derivative import StepsDerivative

ENDS, STEP = (0.4, 1.0), 1e-30
SHAPE = (4, 5, 4)


def sizes(v):
    """Lengths of vectors as an analytic function: no absolute values of complex numbers."""
    return np.sqrt((v * v).sum(axis=-1))


def spline(centres, values, targets):
    """Thin plate spline with a linear polynomial."""

    def phi(a, b):
        square = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
        return np.where(square == 0.0, 0.0, 0.5 * square * np.log(np.where(square == 0.0, 1.0, square)))

    def terms(x):
        return np.concatenate([np.ones((len(x), 1)), x], axis=1)

    n, p = len(centres), terms(centres)
    system = np.block([[phi(centres, centres), p], [p.T, np.zeros((4, 4))]])
    solved = np.linalg.solve(system, np.concatenate([values, np.zeros((4, 3))]))
    return phi(targets, centres) @ solved[:n] + terms(targets) @ solved[n:]


def blended(values, arc):
    """Faces less edges plus corners of a block, at all of its nodes."""
    total = np.zeros_like(arc)
    for fixed in itertools.product((False, True), repeat=3):
        axes = [axis for axis in range(3) if fixed[axis]]
        for ends in itertools.product((0, -1), repeat=len(axes)):
            at, factor = [slice(None)] * 3, -1.0
            for axis, end in zip(axes, ends, strict=True):
                at[axis] = slice(0, 1) if end == 0 else slice(-1, None)
                factor = -factor * (arc[..., axis, None] if end else 1.0 - arc[..., axis, None])
            if axes:
                total = total + factor * values[tuple(at)]
    return total


def filled(x, d, bent):
    """TFI of the displacement ``d`` of a block at ``x`` from its faces; ``bent``: with the affine image of what the
    block itself deviates from its own TFI."""
    arc = np.zeros_like(x)
    for axis in range(3):
        along = np.moveaxis(x, axis, 0)
        part = np.concatenate([0 * along[:1, ..., 0], np.cumsum(sizes(np.diff(along, axis=0)), axis=0)])
        arc[..., axis] = np.moveaxis(part / part[-1], 0, axis)
    if not bent:
        return blended(d, arc)
    corners = tuple(np.meshgrid(*((0, n - 1) for n in x.shape[:3]), indexing="ij"))
    ends, moved = x[corners].reshape(8, 3), d[corners].reshape(8, 3)
    arms, moved = ends - ends.mean(axis=0), moved - moved.mean(axis=0)
    return blended(d, arc) + (x - blended(x, arc)) @ np.linalg.solve(arms.T @ arms, arms.T @ moved)


def on_faces(shape):
    inside = np.zeros(shape, dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    return ~inside


def one_step(name, blocks, total):
    """Displacements of all nodes of blocks in a row along i, of which the outer faces move by ``total``."""
    whole = np.concatenate([blocks[0], *(block[1:] for block in blocks[1:])])
    given, outer = np.concatenate([total[0], *(d[1:] for d in total[1:])]), on_faces(whole.shape[:3])
    found = given.copy()
    if name != "tfi":
        found[~outer] = spline(whole[outer], given[outer], whole[~outer])
    first, moved = 0, []
    for block in blocks:
        own = found[first : first + len(block)]
        if name != "rbf":
            own = np.where(on_faces(own.shape[:3])[..., None], own, filled(block, own, bent=name != "tfi"))
        moved.append(own)
        first += len(block) - 1
    return moved


def twin(name, blocks, total):
    """The displacement after all steps."""
    x, before = [block + 0j for block in blocks], 0.0
    for end in ENDS:
        moved = one_step(name, x, [(end - before) * d for d in total])
        x, before = [block + d for block, d in zip(x, moved, strict=True)], end
    return [block - start for block, start in zip(x, blocks, strict=True)]


def row_of_blocks(count):
    """Irregular blocks in a row along i, with common faces."""
    n = count * (SHAPE[0] - 1) + 1
    x = np.stack(np.meshgrid(np.arange(n), *(np.arange(m) for m in SHAPE[1:]), indexing="ij"), -1).astype(float)
    x += 0.25 * np.random.default_rng(3).random(x.shape)
    return [x[k * (SHAPE[0] - 1) :][: SHAPE[0]].copy() for k in range(count)]


@pytest.mark.parametrize(("name", "count"), [("tfi", 1), ("rbf", 1), ("rbf-tfi", 2)])
def test_complex_steps_of_a_plain_twin(name, count):
    blocks = row_of_blocks(count)
    grid = Grid.from_blocks([block.copy() for block in blocks])
    where = problem_of(grid, everything_moves())
    options = Options(name, tfi=TFI(max_cells=100)) if name == "rbf-tfi" else Options(name)
    random = np.random.default_rng(4)
    at, change = (size * random.standard_normal(where.source_points.shape) for size in (0.05, 1.0))

    def on_blocks(values):
        unique = np.zeros((where.topology.n_unique, 3), dtype=values.dtype)
        unique[where.source_numbers] = values
        flat = np.zeros((grid.n_nodes, 3), dtype=values.dtype)
        flat[where.topology.face_nodes] = unique[where.topology.number]
        return [grid.block(n, flat) for n in range(count)]

    expected = twin(name, blocks, on_blocks(at + 1j * STEP * change))
    found = StepsDerivative(make_method(options).prepare(where), options, where, at, ENDS)
    moved = found.push(change)
    for n, each in enumerate(expected):
        np.testing.assert_allclose(grid.block(n, found.points) - blocks[n], each.real, atol=1e-12)
        np.testing.assert_allclose(grid.block(n, moved), each.imag / STEP, atol=1e-11 * np.abs(moved).max())
    weight = random.standard_normal(moved.shape)
    product = sum((grid.block(n, weight) * each.imag / STEP).sum() for n, each in enumerate(expected))
    assert (found.pull(weight.copy()) * change).sum() == (pytest.approx(product, rel=1e-10))
