"""Random small multi-block grids for property tests: a box cut into blocks and bent, the blocks turned and shuffled."""

import itertools
from dataclasses import dataclass

import numpy as np
from grids import turn_back, turn_block
from hypothesis import strategies as st

from meshdeform_core.grid import Grid

ORIENTATIONS = [
    (axes, flips) for axes in itertools.permutations(range(3)) for flips in itertools.product((False, True), repeat=3)
]
"""The 48 ways in which a block's indices can run."""


@dataclass(frozen=True)
class BlockGrid:
    """A grid as it was drawn.

    ``parts`` are the blocks as cut from the box, ``order[n]`` is the part that block ``n`` of the grid shows, with its
    indices turned by ``turns[n]``.
    """

    parts: tuple[np.ndarray, ...]
    order: tuple[int, ...]
    turns: tuple[tuple[tuple[int, ...], tuple[bool, ...]], ...]

    @property
    def plain(self) -> Grid:
        """Blocks in their first order and orientation."""
        return Grid.from_blocks(list(self.parts))

    @property
    def shuffled(self) -> Grid:
        """The same blocks in another order, their indices permuted and flipped."""
        turned = zip(self.order, self.turns, strict=True)
        return Grid.from_blocks([turn_block(self.parts[part], *turn) for part, turn in turned])

    def in_first_order(self, grid: Grid, values: np.ndarray) -> np.ndarray:
        """Values of the shuffled grid's nodes as those of the plain one's."""
        parts = [np.empty(0)] * len(self.parts)
        for block, (part, turn) in enumerate(zip(self.order, self.turns, strict=True)):
            parts[part] = turn_back(grid.block(block, values), *turn).reshape(-1, 3)
        return np.concatenate(parts)


def bend(x: np.ndarray, strength: float) -> np.ndarray:
    """A smooth curvilinear map; equal points stay equal to the last bit."""
    u, v, w = x[..., 0], x[..., 1], x[..., 2]
    waves = np.stack([np.sin(2 * v + w), np.sin(2 * w - u), np.cos(2 * u + v)], axis=-1)
    return x + strength * waves


@st.composite
def block_grids(draw: st.DrawFn, straight: bool = False) -> BlockGrid:
    """One to eight blocks of 1 to 4 cells per direction, sometimes with one missing; ``straight``: lines are."""
    lines, spans = [], []
    for _ in range(3):
        cells = draw(st.lists(st.integers(1, 4), min_size=1, max_size=2))
        steps = np.array(draw(st.lists(st.floats(0.3, 1.0), min_size=sum(cells), max_size=sum(cells))))
        lines.append(np.concatenate([[0.0], np.cumsum(steps) / steps.sum()]))
        ends = np.cumsum([0, *cells])
        spans.append([slice(a, b + 1) for a, b in itertools.pairwise(ends)])
    strength = 0.0 if straight else draw(st.sampled_from([0.03, 0.06]))
    box = bend(np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1), strength)
    parts = [box[window] for window in itertools.product(*spans)]
    if len(parts) > 3 and draw(st.booleans()):
        parts.pop(draw(st.integers(0, len(parts) - 1)))
    order = draw(st.permutations(range(len(parts))))
    turns = draw(st.lists(st.sampled_from(ORIENTATIONS), min_size=len(parts), max_size=len(parts)))
    return BlockGrid(tuple(parts), tuple(order), tuple(turns))
