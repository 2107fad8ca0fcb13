"""The share of one rank of many in the deformation of a large grid: its time by stage, and its memory.

    python benchmarks/share.py 1e9 64 5

The rank is alone. It computes everything that a rank of so many does, on the nodes that it would hold and on all nodes
near block faces, but nobody answers: undeformed nodes of other ranks come from the formula of the box, and nodes that
others would move stay where they are. So the time contains no messages and no file, and the grid that results is no
answer to anything.
"""

from __future__ import annotations

import argparse
import time
import tomllib

import numpy as np
from blocks import CASE, bent
from tables import MarkdownTable

from meshdeform_core.deform import deform
from meshdeform_core.grid import Grid
from meshdeform_core.grid.near import NearNodes
from meshdeform_core.memory import peak_memory
from meshdeform_core.parallel import OneRank, Part, dividing, sharing
from meshdeform_formats.case import case_of

_PLANES = 4


class LonelyRank(OneRank):
    """Rank ``number`` of ``count``; what the others would send is missing."""

    def __init__(self, number: int, count: int) -> None:
        super().__init__(cores=1)
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


class Box(Part):
    """Coordinates of the box, of which every row can be computed."""

    def __init__(self, part: Part, n: int) -> None:
        super().__init__(part.ranks, part.bounds, part.shape, part.dtype)
        self._n = n
        self._fill(self.low, self.high)

    def at(self, rows):
        """Coordinates of rows."""
        i, rest = np.divmod(rows, self._n**2)
        return bent(*(index / (self._n - 1) for index in (i, *np.divmod(rest, self._n))))

    def _fill(self, first: int, last: int) -> None:
        for begin in range(first, last, _PLANES * self._n**2):
            end = min(begin + _PLANES * self._n**2, last)
            self.rows[begin:end] = self.at(np.arange(begin, end))

    def _sent(self, rows):
        return self.at(rows)

    def widen(self, first: int, last: int) -> None:
        self._fill(first, min(first, self.low))
        self._fill(max(last, self.high), last)
        super().widen(first, last)
        self._fill(first, self.low)
        self._fill(self.high, last)


def share(nodes: int, count: int, number: int, method: str) -> MarkdownTable:
    """Deform the share of rank ``number`` of a box in one block."""
    n = round(nodes ** (1 / 3))
    # A motion that is small against the cells, as the nodes of others stay.
    text = CASE.replace('"0.01*sin', '"1e-4*sin').replace('"0.03*sin', '"1e-4*sin')
    case = case_of({**tomllib.loads(text), "method": {"name": method}, "repair": {"mode": "off"}}).case
    table = MarkdownTable(f"One of {count} ranks: {n**3:,} nodes in one block, {method}, without messages and files")
    with sharing(LonelyRank(number, count), 1), dividing():
        grid = Grid.allocate([(n, n, n)])
        if grid.points.low == grid.points.high:
            raise SystemExit(
                f"rank {number} of {count} has no nodes, as {n**3:,} nodes are cut into fewer pieces; expected more "
                f"nodes, or another rank"
            )
        points = Box(grid.points, n)
        grid = grid.moved(points)
        points.keep(NearNodes.of(grid.shapes, grid.offsets))
        start = time.process_time()
        result = deform(grid, case, steps=1)
        seconds = {**result.timing.seconds, "all of it": time.process_time() - start}
    own = points.high - points.low
    for stage, each in seconds.items():
        table.rows.append({"stage": stage, "s": each, "us per node of the rank": 1e6 * each / own})
    table.notes += [
        f"{own:,} nodes of the rank, {grid.n_face_nodes:,} on block faces",
        "stages: wall time; all of it: processor time",
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
    wanted = parser.parse_args()
    print(share(int(wanted.nodes), wanted.ranks, wanted.number, wanted.method).markdown())


if __name__ == "__main__":
    main()
