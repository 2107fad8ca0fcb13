"""The share of one rank of many in the deformation of a large grid: its time by stage, and its memory.

    python benchmarks/share.py 1e9 64 5
    python benchmarks/share.py 1e7 64 5 --blocks 1000

The rank is alone. It computes everything that a rank of so many does, on the nodes that it would hold and on all nodes
near block faces, but nobody answers: undeformed nodes of other ranks come from the formula of the box, and nodes that
others would move stay where they are. So the time contains no messages and no file, and the grid that results is no
answer to anything.

The ranks find the topology together, each its share. As what one of them finds is worth nothing without the others,
this one finds all of it, before the measurement; the table has the time on a line of its own.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from contextlib import contextmanager
from unittest import mock

import numpy as np
from blocks import CASE, bent
from tables import MarkdownTable

from meshdeform_core import setup
from meshdeform_core.deform import deform
from meshdeform_core.grid import Grid
from meshdeform_core.memory import peak_memory
from meshdeform_core.parallel import Nodes, Ranks, sharing
from meshdeform_formats.case import case_of

_TOGETHER = 1 << 20
"""Rows computed at a time."""


class LonelyRank(Ranks):
    """Rank ``number`` of ``count``; what the others would send is missing."""

    def __init__(self, number: int, count: int) -> None:
        self.cores = 1
        self.number, self.count, self.on_machine = number, count, 1

    def gather(self, found):
        """As if all others had found the same."""
        return list(found) * self.count

    def collect(self, own, counts):
        """Its own rows, and for those of the others the first of them."""
        ends = np.cumsum([0, *counts])
        found = np.zeros((ends[-1], *own.shape[1:]), own.dtype)
        found[ends[self.number] : ends[self.number + 1]] = own
        return found

    def swap(self, sends, receives):
        """Planes beside its own continue these linearly, so that the cells between them are sound."""
        for other, wanted in receives.items():
            if len(wanted):
                own, size = sends[other], len(wanted)
                if len(own) < 2 * size:
                    raise SystemExit(
                        f"rank {self.number} sends {len(own):,} rows to rank {other}, from which {size:,} rows are to "
                        f"be continued; expected at least {2 * size:,}: choose fewer ranks or more nodes"
                    )
                near, next_one = (own[:size], own[size:]) if other < self.number else (own[-size:], own[:-size])
                wanted[:] = 2 * near - (next_one[:size] if other < self.number else next_one[-size:])


class Box(Nodes):
    """Coordinates of the box, of which every row can be computed; ``m`` blocks of ``n`` nodes along each direction."""

    def __init__(self, part: Nodes, m: int, n: int) -> None:
        super().__init__(part.ranks, part.bounds, part.rows)
        self._m, self._n = m, n
        self._fill(self.low, self.high)

    def at(self, rows):
        """Coordinates of rows."""
        block, row = np.divmod(rows, self._n**3)
        places = [np.unravel_index(each, (size,) * 3) for each, size in ((block, self._m), (row, self._n))]
        cells = self._m * (self._n - 1)
        return bent(*((outer * (self._n - 1) + inner) / cells for outer, inner in zip(*places, strict=True)))

    def _fill(self, first: int, last: int) -> None:
        for begin in range(first, last, _TOGETHER):
            end = min(begin + _TOGETHER, last)
            self.rows[begin:end] = self.at(np.arange(begin, end))

    def _sent(self, rows):
        return self.at(rows)

    def widen(self, first: int, last: int) -> None:
        self._fill(first, min(first, self.low))
        self._fill(max(last, self.high), last)
        super().widen(first, last)
        self._fill(first, self.low)
        self._fill(self.high, last)


class Everything:
    """All rows of an array in parts, for a process alone."""

    def __init__(self, points: Box) -> None:
        self._points, self.shape, self.dtype = points, points.shape, points.dtype

    def __len__(self) -> int:
        return len(self._points)

    def __getitem__(self, rows):
        return self._points[rows]


@contextmanager
def topology_known(grid: Grid):
    """Within the block, setting up the grid takes no time for the topology; yields the processor time to find it."""
    start = time.process_time()
    known = setup.find_topology(grid.moved(Everything(grid.points)))
    with mock.patch.object(setup, "find_topology", return_value=known):
        yield time.process_time() - start


def share(nodes: int, count: int, number: int, method: str, blocks: int) -> MarkdownTable:
    """Deform the share of rank ``number`` of a box in some blocks."""
    m = round(blocks ** (1 / 3))
    n = round(nodes ** (1 / 3) / m)
    # A motion that is small against the cells, as the nodes of others stay.
    text = CASE.replace('"0.01*sin', '"1e-4*sin').replace('"0.03*sin', '"1e-4*sin')
    case = case_of({**tomllib.loads(text), "method": {"name": method}, "repair": {"mode": "off"}}).case
    table = MarkdownTable(
        f"One of {count} ranks: {(m * n) ** 3:,} nodes, blocks: {m**3:,}, {method}, without messages and files"
    )
    with sharing(threads=1):
        grid = Grid.allocate([(n, n, n)] * m**3, ranks=LonelyRank(number, count))
        if grid.points.low == grid.points.high:
            raise SystemExit(
                f"rank {number} of {count} has no nodes, as {grid.n_nodes:,} nodes are cut into fewer pieces; expected "
                f"more nodes, or another rank"
            )
        points = Box(grid.points, m, n)
        grid = grid.moved(points)
        with topology_known(grid) as of_all_faces:
            start = time.process_time()
            result = deform(grid, case, steps=1)
        seconds = {**result.timing.seconds, "all of it": time.process_time() - start}
    seconds[f"topology of all faces, which {count} ranks find together"] = of_all_faces
    own = points.high - points.low
    for stage, each in seconds.items():
        table.rows.append({"stage": stage, "s": each, "us per node of the rank": 1e6 * each / own})
    table.notes += [
        f"{own:,} nodes of the rank, {grid.n_face_nodes:,} on block faces",
        "stages: wall time; all of it, and the topology: processor time",
        f"peak resident size {peak_memory() / 2**20:,.0f} MiB",
    ]
    return table


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nodes", type=float, nargs="?", default=1e9)
    parser.add_argument("ranks", type=int, nargs="?", default=64)
    parser.add_argument("number", type=int, nargs="?", default=5)
    parser.add_argument("--method", default="idw-tfi")
    parser.add_argument("--blocks", type=int, default=1, help="a cube number")
    wanted = parser.parse_args()
    print(share(int(wanted.nodes), wanted.ranks, wanted.number, wanted.method, wanted.blocks).markdown())


if __name__ == "__main__":
    main()
