"""Work that should run at memory speed (TFI, quality, topology), compared with the time of a copy."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from cases import Motion, motion
from machine import copy_seconds
from runs import make_sample, run
from tables import MarkdownTable, Row, best

from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import Options, PreparedMethod, make_method
from meshdeform_core.parallel import Nodes, thread_count
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.validity import judge
from meshdeform_formats import write_grid

CASES = {"splitter-plate": (16, 32), "hemisphere": (48, 92)}
QUICK = {"splitter-plate": (8,), "hemisphere": (16,)}
_REPEATS, _LEVELS = 7, 5
# Nodes from which the levels of a command take longer than its start varies.
_LARGE = 300_000


def memory_speed(quick: bool) -> MarkdownTable:
    """Times per million nodes, and as multiples of copying the coordinate array."""
    table = MarkdownTable(
        "TFI, quality, topology against copying the coordinate array once",
        notes=[
            "copies, new copies: wall time with all threads, against copying with as many",
            "CPU copies: CPU time of all threads against that of a copy on one of them",
            "a level of a series: writing goes to a binary Plot3D file and includes making it; as in `meshdeform "
            "series`, a level is written while the next one is computed",
            "a level of the command: the difference between series of 3 and of 13 levels, in which everything is "
            "included (evaluating the motion, rotations of walls, crossing boundaries, the state of the series)",
        ],
    )
    for sample, sizes in (QUICK if quick else CASES).items():
        for size in sizes:
            with tempfile.TemporaryDirectory() as folder:
                table.rows += _rows(motion(sample, size), Path(folder) / "level.xyz")
    return table


def _rows(case: Motion, file: Path) -> list[Row]:
    grid = case.setup.grid
    copy, fresh = copy_seconds(grid.n_nodes, thread_count()), best(grid.points.copy, _REPEATS)
    alone = copy_seconds(grid.n_nodes, 1)
    measured = {name: _measured(*work) for name, work in _works(case, file).items()}
    if grid.n_nodes > _LARGE:
        measured["a level of the command, by TFI"] = _of_the_command(case, file.parent)
    return [
        {
            "case": case.label,
            "nodes": grid.n_nodes,
            "what": name,
            "s": seconds,
            "s per million nodes": seconds / grid.n_nodes * 1e6,
            "copies": seconds / copy,
            "new copies": seconds / fresh,
            "CPU copies": cpu / alone,
        }
        for name, (seconds, cpu) in measured.items()
    ]


def _measured(work: Callable[[], object], parts: int = 1) -> tuple[float, float]:
    """Smallest wall and CPU seconds of some runs, of one of the equal ``parts`` of ``work``."""
    work()
    return best(work, _REPEATS) / parts, _cpu(work) / parts


def _works(case: Motion, file: Path) -> dict[str, tuple[Callable[[], object]] | tuple[Callable[[], object], int]]:
    setup, grid = case.setup, case.setup.grid
    prepared = make_method(Options("tfi")).prepare(case.problem)
    after = grid.points + prepared.apply(case.displacement)
    hybrid = make_method(Options("idw-tfi"))
    filler = hybrid.filler.prepare(case.problem, hybrid.filler.skeleton(case.problem))
    field = np.zeros_like(grid.points)
    known = Original(grid, setup.topology)
    assess(known, after, setup.boundary)
    return {
        "TFI, whole apply": (lambda: prepared.apply(case.displacement),),
        "TFI of sub-blocks, filling": (lambda: filler.fill(field),),
        "TFI, set-up": (lambda: make_method(Options("tfi")).prepare(case.problem),),
        "a level by TFI: apply, quality, writing": (lambda: _levels(prepared, case, known, file), _LEVELS),
        "quality, further level": (lambda: assess(known, after, setup.boundary),),
        "quality, before and after": (lambda: assess(Original(grid, setup.topology), after, setup.boundary),),
        "valid or not": (lambda: judge(known, after).invalid,),
        "topology": (lambda: find_topology(grid),),
    }


def _levels(prepared: PreparedMethod, case: Motion, known: Original, file: Path) -> None:
    """Levels of a series, each written while the next one is computed."""
    grid, setup = case.setup.grid, case.setup
    with ThreadPoolExecutor(1) as writer:
        writing: Future[object] | None = None
        for _ in range(_LEVELS):
            points = prepared.apply(case.displacement)
            _add(grid.points, points)
            assess(known, points, setup.boundary)
            if writing:
                writing.result()
            writing = writer.submit(write_grid, grid.moved(points), file)


def _add(points: FloatArray, out: FloatArray) -> None:
    Nodes.of(out).each(lambda rows: np.add(points[rows], out[rows], out=out[rows]))


def _of_the_command(case: Motion, folder: Path) -> tuple[float, float]:
    """Wall and CPU seconds of a level of ``meshdeform series -m tfi``."""
    sample = make_sample(folder, case.sample, case.size)
    text = (sample / "case.toml").read_text(encoding="utf-8")
    text = text.replace("2*pi*frequency*t", "0.5*pi*t").replace("frequency = 1e3\n", "")
    (sample / "levels.toml").write_text(text.replace('angle = "angle"', 'angle = "angle*t"'), encoding="utf-8")
    found = []
    for count in (3, 13):
        # The motion shrinks: what is done anew whenever it grows counts for the first level.
        times = ",".join(f"{0.03 * n - 1.0:.2f}" for n in range(count))
        command = [sys.executable, "-m", "meshdeform", "series", f"{sample}/grid.cgns", "-c", f"{sample}/levels.toml"]
        command += ["-m", "tfi", "-o", f"{folder}/levels", "--suffix", ".xyz", f"--times={times}", "--repair", "off"]
        runs = []
        for _ in range(3):
            shutil.rmtree(folder / "levels", ignore_errors=True)
            wall, usage = run([*command, "--allow-invalid", "-q"])
            runs.append((wall, usage.ru_utime + usage.ru_stime))
        found.append([min(column) for column in zip(*runs, strict=True)])
    (short, short_cpu), (long, long_cpu) = found
    return (long - short) / 10, (long_cpu - short_cpu) / 10


def _cpu(work: Callable[[], object]) -> float:
    """Smallest CPU time of some runs."""
    seconds = []
    for _ in range(_REPEATS):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)
