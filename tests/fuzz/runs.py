"""The class of repairs."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
from grids import CASE

from meshdeform_formats import read_grid, write_grid

from . import judges
from .bench import Bench, called, refusal
from .mutations import mutated

FOLDED = CASE.replace("turn = 10.0", "turn = 70.0")


def prepare(bench: Bench) -> None:
    """A grid with invalid cells, as another program might make it."""
    Path("folded.toml").write_text(FOLDED)
    arguments = ("deform", "grid.xyz", "-c", "folded.toml", "-m", "tfi", "--repair", "off", "--steps", "1", "-q")
    assert called(*arguments, "--allow-invalid", "-o", "folded.xyz")[0] == 0
    write_grid(read_grid("folded.xyz"), "folded.fmt", {"encoding": "ascii"})


def repair(bench: Bench, rng: Random) -> str:
    """A folded grid is repaired by a reference, one of the two perhaps damaged; outside faces stay."""
    Path("bad.fmt").write_bytes(bench.valid["folded.fmt"])
    Path("reference.fmt").write_bytes(bench.valid["grid.p3dfmt"])
    for name in rng.choice(((), ("bad.fmt",), ("reference.fmt",), ("bad.fmt", "reference.fmt"))):
        Path(name).write_bytes(mutated(Path(name).read_bytes(), True, rng))
    more = rng.choice(
        ((), ("--polish",), ("-c", "folded.toml"), ("--min-jacobian", rng.choice(("0.2", "-1", "nan", "9"))))
    )
    code, told = called("repair", "bad.fmt", "--reference", "reference.fmt", "-o", "mended.xyz", "--force", "-q", *more)
    if code != 0:
        return "ok" if code == 3 else refusal(code, told)
    before, bent, after = (read_grid(name) for name in ("reference.fmt", "bad.fmt", "mended.xyz"))
    for name, grid in (("reference.fmt", before), ("bad.fmt", bent)):
        if wrong := judges.plot3d_text(Path(name), grid):
            return f"{name}: {wrong}"
    bad = judges.newly_bad(before, after)
    if bad:
        return f"{bad} cells are invalid and the exit code is 0"
    # A damaged reference may have an inner node where the body is.
    whole = read_grid("grid.xyz").points
    outside = np.abs((whole if whole.shape == before.points.shape else before.points)[:, :2]).max(axis=1)
    still = (np.abs(outside - 2.0) < 1e-9) | (outside < 0.51)
    return "ok" if np.abs(after.points - bent.points)[still].max() < 1e-9 else "the boundary has moved"


KINDS = {"repair": repair}
