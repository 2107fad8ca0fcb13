"""Series of a hundred levels, through the command line, against runs of single levels that know of no others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.deform import set_up
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.memory import COORDINATE_ARRAYS, PROGRAM_BYTES
from meshdeform_core.methods import make_method
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case

pytestmark = pytest.mark.slow

LEVELS = 100
PERIOD = "amplitude*z/radius*sin(2*pi*t)*cos(4*atan2(hypot(x, y), z))"
MEMBRANE = f"""
[constants]
amplitude = 1.1e-2
radius = 0.075

[[boundary]]
name = "membrane"
select = ["membrane"]
motion = [{{ displace = ["x/radius*{PERIOD}", "y/radius*{PERIOD}", "z/radius*{PERIOD}"] }}]

[[boundary]]
name = "rigid"
select = ["plate", "outer"]
kind = "fixed"
"""
BODY = """
[[boundary]]
name = "body"
select = ["body"]
motion = [
  { displace = ["0", "where(x > 0.5, 0.2*sin(4*pi*t)*sin(2*pi*(x-0.5)/5), 0)", "0"] },
  { rotate = { angle = "20*sin(2*pi*t)", axis = [0, 0, 1] } },
]

[[boundary]]
name = "outer"
select = ["outer"]
kind = "fixed"

[[boundary]]
name = "span"
select = ["span"]
kind = "slip"
"""
TABLES = """
[[boundary]]
name = "membrane"
select = ["membrane"]
motion = [{ files = "noise_*.csv", times = "0:99:1" }]

[[boundary]]
name = "rigid"
select = ["plate", "outer"]
kind = "fixed"
"""
TIMES = {"sin.toml": "0:0.99:0.01", "body.toml": "0:0.99:0.01"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from meshdeform_cli.main import run

    target = tmp_path_factory.mktemp("levels")
    for sample, size in (("hemisphere", 8), ("splitter-plate", 8)):
        assert run(["sample", sample, "-o", str(target / sample), "--size", str(size)]) == 0
    (target / "hemisphere/sin.toml").write_text(MEMBRANE)
    (target / "hemisphere/noise.toml").write_text(TABLES)
    (target / "splitter-plate/body.toml").write_text(BODY)
    grid = read_grid(target / "hemisphere/grid.cgns")
    nodes = grid.points[find_topology(grid).first]
    wall = nodes[np.abs(np.linalg.norm(nodes, axis=1) - 0.075) < 1e-9]
    rng = np.random.default_rng(4)
    for level in range(LEVELS):
        moved = 4e-3 * np.sin(0.3 * level) * wall * [[1.0, 0.5, 2.0]] / 0.075 * wall[:, 2:] / 0.075
        moved += 2e-5 * rng.standard_normal(wall.shape) * (wall[:, 2:] / 0.075)
        name = target / f"hemisphere/noise_{level:03d}.csv"
        np.savetxt(name, np.hstack([wall, moved]), "%.17g", delimiter=",", header="x,y,z,dx,dy,dz")
    return target


def series(folder: Path, sample: str, case: str, method: str, out: str, *more: str) -> dict:
    from meshdeform_cli.main import run

    place = folder / sample
    times = ["--times", TIMES[case]] if case in TIMES else []
    arguments = ["series", place / "grid.cgns", "-c", place / case, "-m", method, "-o", folder / out, *times, *more]
    report = folder / f"{out}.json"
    assert run([str(a) for a in (*arguments, "--report", report, "-q", "--suffix", ".xyz")]) == 0
    return json.loads(report.read_text())


def largest_difference(folder: Path, sample: str, case: str, method: str, report: dict, out: str, every: int) -> float:
    """Of the coordinates of every n-th level from what the method gives when it is prepared for the level alone."""
    place, largest = folder / sample, 0.0
    grid = read_grid(place / "grid.cgns")
    what = read_case(place / case, (), method, None).case
    setup = set_up(grid, what)
    assert len(report["levels"]) == LEVELS
    for level in report["levels"][::every]:
        displacement = setup.displacement(level["time"])[setup.problem.source_numbers]
        single = grid.points + make_method(what.method).prepare(setup.problem).apply(displacement)
        found = read_grid(folder / out / level["file"]).points
        largest = max(largest, float(np.abs(found - single).max()))
    return largest


@pytest.mark.parametrize(
    ("sample", "case", "method", "tolerance", "every"),
    [
        # Twice the tolerance of the solver (1e-6) times the largest displacement; idw-tfi and tfi are not iterative.
        ("hemisphere", "sin.toml", "rbf-tfi", 2e-6 * 1.1e-2, 1),
        ("hemisphere", "sin.toml", "tfi", 1e-13, 1),
        ("splitter-plate", "body.toml", "idw-tfi", 1e-12, 9),
        ("hemisphere", "noise.toml", "rbf", 2e-6 * 8e-3, 1),
    ],
)
def test_levels_are_those_of_single_runs(folder, sample, case, method, tolerance, every):
    out = f"{case}-{method}"
    report = series(folder, sample, case, method, out, "--repair", "off")
    assert largest_difference(folder, sample, case, method, report, out, every) <= tolerance


def test_without_memory_for_fields_the_results_are_the_same(folder):
    linear = ["-s", "method.idw.rotation=none", "-s", "method.idw.alpha=0.3"]
    known = series(folder, "hemisphere", "sin.toml", "idw", "much", *linear)
    nodes = known["grid"]["nodes"]
    # Less than four coordinate arrays beside what the program and the grid need: no room for a field.
    cap = PROGRAM_BYTES + (COORDINATE_ARRAYS + 3) * 24 * nodes
    tight = series(folder, "hemisphere", "sin.toml", "idw", "little", *linear, "--max-memory", str(cap))
    for one, two in zip(known["levels"], tight["levels"], strict=True):
        combined = read_grid(folder / "much" / one["file"]).points
        computed = read_grid(folder / "little" / two["file"]).points
        np.testing.assert_allclose(combined, computed, rtol=0, atol=1e-13)
    numbers = [sum("combined_from" not in json.dumps(level) for level in r["levels"]) for r in (known, tight)]
    assert numbers[0] <= 6
    assert numbers[1] == LEVELS
