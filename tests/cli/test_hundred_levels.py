"""Series of a hundred levels, through the command line, against runs of single levels that know of no others."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from meshdeform_core.deform import set_up
from meshdeform_core.errors import MethodError
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.memory import COORDINATE_ARRAYS, SMOOTHNESS_ARRAYS, Demand
from meshdeform_core.methods import make_method
from meshdeform_core.series import Level, _Series
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case

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
TIMES = {"sin.toml": "0:0.99:0.01", "body.toml": "0:0.99:0.03"}
"""The grid of the body has as many nodes as thirteen of the other."""


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
    times = ["--times", TIMES[case]] if case in TIMES and "--times" not in more else []
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
    assert len(report["levels"]) == (34 if case == "body.toml" else LEVELS)
    for level in report["levels"][::every]:
        displacement = setup.displacement(level["time"])[setup.problem.source_numbers]
        single = grid.points + make_method(what.method).prepare(setup.problem).apply(displacement)
        found = read_grid(folder / out / level["file"]).points
        largest = max(largest, float(np.abs(found - single).max()))
    return largest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sample", "case", "method", "every"),
    [
        ("hemisphere", "sin.toml", "rbf-tfi", 9),
        ("hemisphere", "sin.toml", "tfi", 1),
        ("splitter-plate", "body.toml", "idw-tfi", 3),
        ("hemisphere", "noise.toml", "rbf", 9),
    ],
)
def test_levels_are_those_of_single_runs(folder, sample, case, method, every):
    out = f"{case}-{method}"
    report = series(folder, sample, case, method, out, "--repair", "off")
    assert largest_difference(folder, sample, case, method, report, out, every) == 0.0


FEW = ("--times", "0.03:0.33:0.1", "--repair", "off")
FAST = (*FEW, "-s", "method.idw.summation=fast")


@pytest.mark.parametrize(
    ("method", "options"),
    [
        pytest.param("idw", FAST, marks=pytest.mark.slow),
        ("idw-tfi", FAST),
        pytest.param("rbf-tfi", (*FEW, "-s", "method.rbf.solver=krylov"), marks=pytest.mark.slow),
        ("tfi", FEW),
    ],
)
def test_files_do_not_depend_on_memory_threads_or_interruption(folder, method, options, monkeypatch):
    def made(out: str, *more: str) -> dict[str, bytes]:
        series(folder, "hemisphere", "sin.toml", method, out, *options, *more)
        return {path.name: path.read_bytes() for path in (folder / out).glob("*.xyz")}

    whole = made(f"{method}-whole", "--threads", "2")
    assert len(whole) == 4
    grid = read_grid(folder / "hemisphere/grid.cgns")
    room = {"rbf-tfi": 200, "tfi": 3}.get(method, 1)
    for arrays in (room, 10 * room):
        cap = Demand.of("deforming", grid, arrays=COORDINATE_ARRAYS + SMOOTHNESS_ARRAYS + arrays).in_memory
        assert made(f"{method}-{arrays}", "--max-memory", str(cap), "--threads", "1") == whole
    stopped = folder / f"{method}-stopped"
    with monkeypatch.context() as patch:
        patch.setattr("meshdeform_core.series._Series.level", _failing_at(2))
        with pytest.raises(AssertionError):
            made(stopped.name)
    assert len(list(stopped.glob("*.xyz"))) == 2
    assert made(stopped.name, "--resume") == whole


def _failing_at(number: int) -> Callable[..., Level]:
    level = _Series.level

    def fails(self: _Series, at: int, past: list) -> Level:
        if at == number:
            raise MethodError("the test stops the series here")
        return level(self, at, past)

    return fails
