"""Times of a series and sequences of displacement files in a case."""

import gc
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest
from cases import body_specs, constant
from grids import frame

from meshdeform_core.deform import Case, set_up
from meshdeform_core.errors import CaseError, MotionError
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats import displacement
from meshdeform_formats.case import read_case
from meshdeform_formats.case.tables import named_files, parse_times
from meshdeform_formats.report.records import boundary_part

CASE = """\
[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [{ files = "surface_*.csv", times = "0:1:0.1" }]
"""


@pytest.mark.parametrize(("text", "times"), [
    ("0:1:0.25", [0, 0.25, 0.5, 0.75, 1.0]), ("0:1:0.3", [0, 0.3, 0.6, 0.9]), ("2:2:1", [2.0]), ("-1:1:1", [-1, 0, 1]),
    ("0, 0.5, 2", [0, 0.5, 2]), ("3", [3.0]),
    *((f"0:{100 * step!r}:{step!r}", [step * n for n in range(101)]) for step in (0.1, 1e-3, 1 / 3, 0.07)),
])  # fmt: skip
def test_times(text, times):
    np.testing.assert_allclose(parse_times(text, "--times"), times, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    "text",
    ["", "a", "0:1", "0:1:0", "0:1:-1", "1:0:0.1", "0:inf:1", "nan", "1,1", "2,1", "0:1:1e-9", "0:1:1:1", "1,,2"],
)
def test_other_times_are_refused(text):
    with pytest.raises(CaseError, match="--times"):
        parse_times(text, "--times")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Eleven tables: the bar moves by n/100 in x; the names sort by their numbers, not as text."""
    (tmp_path / "case.toml").write_text(CASE)
    grid = frame()
    points = np.unique(grid.points[np.abs(grid.points[:, :2]).max(axis=1) < 0.51], axis=0)
    for number in range(11):
        table = np.hstack([points, np.tile([0.01 * number, 0.0, 0.0], (len(points), 1))])
        np.savetxt(tmp_path / f"surface_{number}.csv", table, "%.17g", delimiter=",")
    return tmp_path


def test_levels_follow_the_file_of_their_time_and_one_is_in_memory(folder, monkeypatch, own_garbage):
    alive: list[weakref.ref] = []
    read = displacement.read_displacement

    def watched(path):
        gc.collect()
        assert sum(ref() is not None for ref in alive) == 0
        table = read(path)
        alive.append(weakref.ref(table))
        return table

    monkeypatch.setattr(displacement, "read_displacement", watched)
    case = read_case(folder / "case.toml")
    files = [*case.files, *named_files([{"beam": "b"}], folder)]
    assert [path.name for path in files] == [*(f"surface_{n}.csv" for n in range(11)), "b"]
    grid = frame()
    setup = set_up(grid, case.case)
    wall = setup.topology.first[setup.boundary.kind == 6]
    times = parse_times("0:1:0.1", "times")
    for level in deform_series(setup, Schedule(times), "float64"):
        moved = (level.result.grid.points - grid.points)[wall]
        np.testing.assert_allclose(moved, np.tile([0.1 * level.time, 0, 0], (len(wall), 1)), rtol=0, atol=1e-14)
    # The first is read to find the nodes that it matches, and then no file twice.
    assert len(alive) == 11


def test_times_between_the_files_and_files_of_other_nodes_are_refused(folder):
    setup = set_up(frame(), read_case(folder / "case.toml").case)
    with pytest.raises(MotionError, match=r"no level at t = 0\.25.*11 levels from 0 to 1, the nearest at 0\.[23]"):
        setup.displacement(0.25)
    table = (folder / "surface_1.csv").read_text().splitlines()
    (folder / "surface_1.csv").write_text("\n".join(table[: len(table) // 2]))
    # A file that covers fewer nodes than the first one.
    with pytest.raises(MotionError, match=r"surface_1\.csv"):
        setup.displacement(0.1)


def test_reports_compare_a_table_with_the_nodes_that_it_matches(folder):
    table = np.loadtxt(folder / "surface_1.csv", delimiter=",")
    half = table[table[:, 2] < 0.6] + [0, 0, 1e-3, 0, 0, 0]
    np.savetxt(folder / "half.csv", half, "%.17g", delimiter=",")
    case = read_case(folder / "case.toml", table=folder / "half.csv")
    assert [path.name for path in case.files] == [*(f"surface_{n}.csv" for n in range(11)), "half.csv"]
    case = read_case(None, table=folder / "surface_*.csv", times="0:1:0.1")
    assert [path.name for path in case.files] == [f"surface_{n}.csv" for n in range(11)]
    assert case.case.boundaries[0].motion.steps[0].data(3).label == "surface_3.csv"
    setup = set_up(frame(), read_case(None, table=folder / "half.csv").case)
    assert boundary_part(setup)["matches"] == [
        {"table": "half.csv", "match": "interpolate", "matched_nodes": 40, "unmatched_nodes": 40, "table_points": 40,
         "table_points_used": 40, "max_distance": pytest.approx(1e-3), "max_extrapolation": 0.0,
         "size_ratio": pytest.approx(1.0), "walls": ["block2.imax", "block4.jmax", "block5.jmin", "block7.imin"]}
    ]  # fmt: skip


def test_every_node_that_moves_freely_or_not_is_counted_once():
    setup = set_up(frame(), Case(tuple(body_specs(constant(0.1, 0, 0)))))
    counts = [boundary_part(setup)[f"{kind}_nodes"] for kind in ("moving", "fixed", "slip", "interface")]
    assert min(counts[0], *counts[2:]) > 0
    assert sum(counts) == setup.topology.n_unique


@pytest.mark.parametrize(("old", "new", "words"), [
    ('"surface_*.csv"', '"nothing_*.csv"', "no file matches"), ("times =", "when =", "unknown key 'when'"),
    ('"surface_*.csv"', '["surface_0.csv", "gone.csv"]', "does not exist"),
    ('"surface_*.csv"', "3", "expected a pattern"), ('"0:1:0.1"', '"0:1:0.5"', "11 files .* for 3 times"),
    (', times = "0:1:0.1"', "", "times: there are none"), ('"0:1:0.1"', "[0, true]", "times = .0, true."),
    ('"0:1:0.1"', "[1, 0]", "do not ascend"),
])  # fmt: skip
def test_wrong_sequences_are_refused(folder, old, new, words):
    (folder / "case.toml").write_text(CASE.replace(old, new))
    with pytest.raises(CaseError, match=words):
        read_case(folder / "case.toml")


@pytest.mark.slow
def test_a_process_that_has_read_a_case_ends_in_peace(tmp_path):
    """msgspec's classes crash one interpreter in five at its end where they are freed."""
    (tmp_path / "case.toml").write_text('[[boundary]]\nname = "body"\nmotion = [{ translate = [1, 0, 0] }]\n')
    code = (
        "import sys; from pathlib import Path; from meshdeform_formats.case.reader import read_case; "
        "read_case(Path('case.toml')); sys.exit(4)"
    )
    running = [subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path) for _ in range(8)]
    assert [process.wait(60) for process in running] == [4] * 8
