"""Small deformations that together use every compiled loop."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

from meshdeform_core.deform import deform
from meshdeform_core.methods import IDW, RBF, Options, Progress
from meshdeform_formats.case import read_case
from meshdeform_samples import folder, load

_FAST_IDW, _FAST_RBF = IDW(summation="fast"), RBF(summation="fast", solver="krylov")


def options() -> Iterator[tuple[str, int, Options]]:
    """Sample, size and method of every run."""
    for sample, size in (("hemisphere", 8), ("square", 11)):
        yield from ((sample, size, Options(name)) for name in ("tfi", "idw-tfi", "rbf-tfi", "idw-rbf"))
    for rotation in ("none", "quaternion", "blend"):
        yield "hemisphere", 8, Options("idw", idw=IDW(rotation=rotation, summation="exact"))
    yield "hemisphere", 8, Options("idw", idw=IDW(summation="fast"))
    yield "hemisphere", 8, Options("rbf", rbf=RBF(basis="wendland-c2", radius=1.0, greedy="single"))
    yield "hemisphere", 8, Options("rbf", rbf=_FAST_RBF)
    yield "hemisphere", 8, Options("rbf", rbf=RBF(basis="wendland-c2", radius=0.1, solver="krylov"))
    yield "cascade", 16, Options("idw-tfi")
    yield "splitter-plate", 8, Options("idw-tfi", idw=_FAST_IDW)


def run_everything(progress: Progress) -> None:
    """Deform small grids by every method and discard the results."""
    done = list(options())
    for number, (sample, size, method) in enumerate(done):
        case = read_case(Path(str(folder(sample))) / "case.toml", (), None, None).case
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            deform(load(sample).generate(size), type(case)(case.boundaries, case.constants, method), time=2.5e-4)
        progress("warm-up", number + 1, len(done))
