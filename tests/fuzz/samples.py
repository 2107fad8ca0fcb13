"""The samples of a campaign: which class has which number, and the good files that all start from."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from . import case_files, grid_files, runs, tables, walls
from .bench import METHODS, Bench, called

KINDS: dict[str, Callable[[Bench, Random], str]] = {
    **grid_files.KINDS,
    **tables.KINDS,
    **case_files.KINDS,
    **walls.KINDS,
    **runs.KINDS,
}
SCHEDULE = tuple(KINDS)


class Worker:
    """Makes and judges samples in the current folder."""

    def __init__(self, seed: int):
        self.seed = seed
        self.bench = Bench()
        grid_files.prepare(self.bench)
        tables.prepare(self.bench)
        runs.prepare(self.bench)
        self.bench.keep()

    def warm_up(self) -> None:
        """Compile and load every loop, so that no sample has to."""
        code, told = called("warm-up", "-q")
        assert code == 0, told
        for method in METHODS:
            self.bench.deformed(self.bench.grid, None, "grid.xyz", "-c", "case.toml", "-m", method)

    def sample(self, number: int) -> tuple[str, str]:
        """Class and result of a sample: ``ok`` (accepted, right), ``refused``, or what is wrong."""
        name = SCHEDULE[number % len(SCHEDULE)]
        return name, KINDS[name](self.bench, Random(f"{self.seed}/{number}"))
