"""Cost of a level of a series: the first, a further one, and one that is a combination of earlier ones."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cases import Motion, motion
from runs import make_sample
from tables import MarkdownTable, Row

from meshdeform_core.deform import set_up
from meshdeform_core.grid import FloatArray
from meshdeform_core.memory import COORDINATE_ARRAYS, PROGRAM_BYTES
from meshdeform_core.methods import CATALOGUE, Options, make_method, remembering
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case

METHODS = tuple(CATALOGUE)
_COMBINED = 0.7


def of_every_method(quick: bool) -> MarkdownTable:
    """CPU seconds of preparation and of levels, for every method."""
    table = MarkdownTable(
        "Levels, CPU seconds of all threads",
        notes=[
            "first: the first displacement after the preparation, with all that is made when it is first needed",
            "second, further: the same motion with other amplitudes by place, which are no combinations of earlier "
            "ones; while the motion grows, IDW lists its clusters anew",
            f"combined: {_COMBINED} times the first; only methods that are linear combine",
        ],
    )
    for name in METHODS:
        # Loops are compiled, or loaded, at their first use.
        _levels(motion("splitter-plate", 8), name)
    for sample, size in (("splitter-plate", 8), ("hemisphere", 16)) if quick else (("hemisphere", 48),):
        table.rows += [_levels(motion(sample, size), name) for name in METHODS]
    return table


def _levels(case: Motion, name: str) -> Row:
    problem, d = case.problem, case.displacement
    place = problem.source_points / np.abs(problem.source_points).max()
    start = time.process_time()
    prepared = remembering(make_method(Options(name)).prepare(problem), problem)
    row = {"case": case.label, "nodes": case.setup.grid.n_nodes, "method": name, "set-up": time.process_time() - start}
    row["first"] = _cpu(prepared.apply, d)
    for which, size, waves in (("second", 1.0, 7.0), ("further", 0.8, 5.0)):
        row[which] = _cpu(prepared.apply, size * d * (1.0 + 0.1 * np.cos(waves * place)))
    row["further / first"] = row["further"] / row["first"]
    combined = _cpu(prepared.apply, _COMBINED * d)
    return row | {"combined": combined if "combined_from" in prepared.account.settings else ""}


def _cpu(work: Callable[[FloatArray], object], displacement: FloatArray) -> float:
    start = time.process_time()
    work(displacement)
    return time.process_time() - start


def hundred_levels(quick: bool) -> MarkdownTable:
    """Series of levels through the command line against the method prepared anew for every level."""
    table = MarkdownTable(
        "Series, file to file, against single levels",
        notes=[
            "difference: largest distance of a node from where the method puts it when it knows of no other level, of "
            "all levels, relative to the largest displacement",
            "computed: levels that were no combination of stored fields",
            "capped: --max-memory for the grid and hardly more, so that no fields are stored",
        ],
    )
    levels = 10 if quick else 100
    with tempfile.TemporaryDirectory() as name:
        for sample, size, methods in (
            ("hemisphere", 8 if quick else 16, ("rbf-tfi", "tfi")), ("splitter-plate", 8, ("idw-tfi",))
        ):  # fmt: skip
            folder = make_sample(Path(name), sample, size)
            _swing(folder / "case.toml", sample)
            table.rows += [_series(folder, method, levels, "") for method in methods]
            if sample == "hemisphere":
                # Less than the four arrays that a stored field needs beside program and grid.
                cap = PROGRAM_BYTES + (COORDINATE_ARRAYS + 3) * 24 * read_grid(folder / "grid.cgns").n_nodes
                table.rows.append(_series(folder, "tfi", levels, str(cap)))
    return table


def _swing(case: Path, sample: str) -> None:
    """Let the sample's motion depend on the time, with a period of one."""
    text = case.read_text(encoding="utf-8")
    text = text.replace("2*pi*frequency*t", "2*pi*t").replace("frequency = 1e3\n", "")
    text = text.replace('angle = "angle"', 'angle = "angle*sin(2*pi*t)"') if sample == "splitter-plate" else text
    case.write_text(text, encoding="utf-8")


def _series(folder: Path, method: str, levels: int, cap: str) -> Row:
    out, report = folder / "out", folder / "report.json"
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "meshdeform", "series", f"{folder}/grid.cgns", "-c", f"{folder}/case.toml"]
    command += ["-m", method, "-o", str(out), "--suffix", ".xyz", "--repair", "off", "--allow-invalid", "-q"]
    command += ["--times", f"0:{1 - 1 / levels:.12g}:{1 / levels}", "--report", str(report)]
    start = time.perf_counter()
    subprocess.run([*command, *(["--max-memory", cap] if cap else [])], check=True, stdout=subprocess.DEVNULL)
    wall = time.perf_counter() - start
    told = json.loads(report.read_text(encoding="utf-8"))
    difference = _difference(folder, out, method, told["levels"])
    shutil.rmtree(out)
    return {
        "case": folder.name, "method": method, "capped": bool(cap), "levels": len(told["levels"]), "wall s": wall,
        "computed": sum("combined_from" not in json.dumps(level) for level in told["levels"]),
        "difference": difference, "peak MB": told["peak_memory_bytes"] / 1e6,
        "allowed MB": float(cap) / 1e6 if cap else "",
    }  # fmt: skip


def _difference(folder: Path, out: Path, method: str, levels: list[Row]) -> float:
    grid = read_grid(folder / "grid.cgns")
    what = read_case(folder / "case.toml", (), method, None).case
    setup = set_up(grid, what)
    prepared, apart, moved = make_method(what.method), 0.0, 0.0
    for level in levels:
        displacement = setup.displacement(level["time"])[setup.problem.source_numbers]
        single = prepared.prepare(setup.problem).apply(displacement)
        found = read_grid(out / level["file"]).points - grid.points
        apart, moved = max(apart, float(np.abs(found - single).max())), max(moved, float(np.abs(single).max()))
    return apart / moved
