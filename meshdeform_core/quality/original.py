"""The cells of an undeformed grid, measured once however often a deformed one is judged against it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..grid import FloatArray, Grid
from ..grid.topology import Topology
from ..parallel import empty
from .cells import CellMeasures, Slab, measure_cells, slabs
from .tally import Tally


@dataclass(frozen=True)
class Original:
    """An undeformed grid as the judgement needs it.

    ``min_jacobian``: cells with a corner below this share of its undeformed Jacobian count as invalid.

    Attributes
    ----------
    tally : totals over its cells
    bad : (n_cells,) uint8, bit mask of the corners with Jacobian <= 0
    volume : (n_cells,) (2-D: area)
    """

    grid: Grid
    topology: Topology
    min_jacobian: float = 0.0
    tally: Tally = field(init=False)
    bad: np.ndarray = field(init=False)
    volume: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        n_cells = self.grid.n_cells
        tally, bad, volume = Tally(n_cells, len(slabs(self.grid))), empty([n_cells], np.uint8), empty([n_cells])

        def use(number: int, slab: Slab, measures: CellMeasures) -> None:
            tally.put(number, slab, measures)
            bad[slab.cells] = measures.bad.ravel()
            volume[slab.cells] = measures.volume.ravel()

        measure_cells(self.grid, self.topology, self.grid.points, use, [tally.skews, bad, volume], tally.per_slab)
        for name, value in (("tally", tally), ("bad", bad), ("volume", volume)):
            object.__setattr__(self, name, value)
