"""``meshdeform series`` as a user runs it: levels, index, report, going on after a stop, what is refused."""

import contextlib
import functools
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from meshdeform_cli.main import run
from meshdeform_formats import read_grid, write_grid

SWING = """\
[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [{ rotate = { angle = "20*sin(2*pi*t)", axis = [0, 0, 1] } }]

[[boundary]]
name = "span"
select = ["*.kmin", "*.kmax"]
kind = "slip"
"""
RUN = ("series", "grid.xyz", "-c", "swing.toml", "-o", "out", "--times", "0:1:0.25")


@pytest.fixture
def swing(bench: Path) -> Path:
    (bench / "swing.toml").write_text(SWING)
    return bench


@pytest.fixture(scope="module")
def _finished(_template: Path, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "bench"
    shutil.copytree(_template, folder)
    (folder / "swing.toml").write_text(SWING)
    with contextlib.chdir(folder):
        assert run([*RUN, "--report", "report.json", "-q"]) == 0
    return folder


@pytest.fixture
def done(_finished: Path, tmp_path: Path, monkeypatch) -> dict:
    """The report of ``RUN``, whose outputs are in the folder."""
    shutil.copytree(_finished, tmp_path / "done")
    monkeypatch.chdir(tmp_path / "done")
    return json.loads(Path("report.json").read_text())


def report_of(call, *arguments: str, code: int = 0) -> dict:
    Path("report.json").unlink(missing_ok=True)
    result = call(*arguments, "--report", "report.json", "-q")
    assert result.code == code, result.err
    return json.loads(Path("report.json").read_text())


def test_one_grid_per_level_and_back_after_a_period(done, call):
    files = [level["file"] for level in done["levels"]]
    assert files == [f"grid_{n:04d}.xyz" for n in range(5)]
    assert sorted(path.name for path in Path("out").iterdir()) == ["grid.series.p3d", *files, "series.json"]
    start, quarter, end = (read_grid(f"out/grid_{n:04d}.xyz").points for n in (0, 1, 4))
    np.testing.assert_array_equal(start, read_grid("grid.xyz").points)
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-12)
    assert call("deform", "grid.xyz", "-c", "swing.toml", "-o", "one.xyz", "--time", "0.25").code == 0
    np.testing.assert_array_equal(quarter, read_grid("one.xyz").points)


def test_the_report_has_every_level_and_shows_that_preparation_happened_once(done):
    report = done
    assert (report["schema"], report["valid"]) == (1, True)
    assert [level["time"] for level in report["levels"]] == [0, 0.25, 0.5, 0.75, 1]
    assert json.loads(Path("out/series.json").read_text())["complete"] is True
    prepare = [level["timing"].get("prepare", 0.0) for level in report["levels"]]
    assert prepare[0] > 0
    assert prepare[1:] == [0.0] * 4
    assert report["timing"]["prepare"] == prepare[0]
    skew = [level["quality"]["f_skew"] for level in report["levels"]]
    assert skew[0]["min"] == pytest.approx(skew[2]["min"])
    assert skew[1]["harmonic_mean"] < skew[0]["harmonic_mean"]
    assert all(level["warnings"] == [] for level in report["levels"])
    smooth = [level["smoothness"] for level in report["levels"]]
    assert [s["velocity"] is None for s in smooth] == [True, False, False, False, False]
    assert [s["acceleration"] is None for s in smooth] == [True, True, False, False, False]
    assert 1.0 - 1e-9 <= smooth[2]["velocity"] < 1.5
    assert smooth[4]["acceleration_in_edges"] > 0.0


def test_a_warning_is_given_once_and_not_for_round_off(swing, call):
    (swing / "swing.toml").write_text(
        SWING.replace("motion = [", 'motion = [{ translate = [0, 0, "0.1*sin(pi*t)"] }, ')
    )
    report = report_of(call, *RUN, "--allow-invalid")
    found = [n for n, level in enumerate(report["levels"]) if level["warnings"]]
    assert found == [1]
    assert "out of a slip or symmetry plane by up to 0.0707" in report["levels"][1]["warnings"][0]
    assert sum("out of a slip" in text for text in report["warnings"]) == 1


def test_times_are_those_of_the_displacement_files(swing, call):
    text = SWING.replace(
        'rotate = { angle = "20*sin(2*pi*t)", axis = [0, 0, 1] }', 'files = "move_*.csv", times = [0, 3]'
    )
    (swing / "swing.toml").write_text(text)
    table = (swing / "table.csv").read_text()
    (swing / "move_1.csv").write_text(table.replace("0.1000", "0.0000"))
    (swing / "move_2.csv").write_text(table)
    report = report_of(call, *RUN[:-2])
    assert [level["time"] for level in report["levels"]] == [0, 3]
    assert report["levels"][1]["max_displacement"] == pytest.approx(0.1)
    (swing / "two.toml").write_text(text.replace("motion = [", "motion = [{ files = 'move_*.csv', times = [0, 4] }, "))
    assert "the case has sequences with different times; give" in call(*RUN[:2], "-c", "two.toml", "-o", "new").err
    assert "no level at t = 1" in call(*RUN[:4], "-o", "new", "--times", "0:3:1").err


def test_displacement_files_alone_are_enough(swing, call):
    table = (swing / "table.csv").read_text()
    (swing / "move_9.csv").write_text(table.replace("0.1000", "0.0000"))
    (swing / "move_10.csv").write_text(table)
    report = report_of(call, "series", "grid.xyz", "-d", "move_*.csv", "--times", "0,1", "-o", "out")
    assert [level["max_displacement"] for level in report["levels"]] == pytest.approx([0, 0.1])
    assert report["boundary"]["moving_nodes"] == 80
    assert "need their times" in call("series", "grid.xyz", "-d", "move_*.csv", "-o", "new").err
    assert "2 files" in call("series", "grid.xyz", "-d", "move_*.csv", "-o", "new", "--times", "0:2:1").err


def test_a_broken_level_is_written_and_gives_exit_3(swing, call):
    (swing / "swing.toml").write_text(SWING.replace("20*sin(2*pi*t)", "150*sin(pi*t)"))
    result = call(*RUN, "--repair", "off", "--report", "r.json")
    assert result.code == 3
    assert "3 of 5 levels are not valid, first level 1 (t = 0.25)" in result.err
    report = json.loads(Path("r.json").read_text())
    assert [level["valid"] for level in report["levels"]] == [True, False, False, False, True]
    assert report["levels"][1]["invalid_cells"][0]["nearest_patch"] in ("body", "span")
    assert len(report["levels"][1]["invalid_cells"]) == 20 < report["levels"][1]["quality"]["invalid_cells"]
    assert "It is in grid_0001.invalid.xyz" in result.err
    files = [f"grid_{n:04d}{'' if n in (0, 4) else '.invalid'}.xyz" for n in range(5)]
    assert [level["file"] for level in report["levels"]] == files
    assert not Path("out/grid_0001.xyz").exists()
    assert "grid_0001.invalid.xyz" in Path("out/grid.series.p3d").read_text()
    invalid = read_grid("out/grid_0001.invalid.xyz").points
    assert call(*RUN, "--repair", "off", "--force", "--allow-invalid").code == 0
    assert not Path("out/grid_0001.invalid.xyz").exists()
    np.testing.assert_array_equal(read_grid("out/grid_0001.xyz").points, invalid)


def files_in(folder: str) -> list[str]:
    return sorted(path.name for path in Path(folder).rglob("*") if path.is_file())


@pytest.mark.parametrize("options", [
    ("--suffix", ".vtm"), ("--suffix", ".cgns", "--velocity", "second"),
])  # fmt: skip
def test_a_series_with_a_broken_level_goes_on(options, swing, call):
    """The names of broken levels are known again, and levels are made from them."""
    (swing / "swing.toml").write_text(SWING.replace("20*sin(2*pi*t)", "150*sin(pi*t)"))
    run = ("series", "grid.xyz", "-c", "swing.toml", "--times", "0:1:0.5", "--repair", "off", "-q", *options)
    assert call(*run, "-o", "whole").code == 3
    assert any(".invalid." in name for name in files_in("whole"))
    shutil.copytree("whole", "part")
    before = files_in("part")
    # As if the run had stopped after the second level.
    state = json.loads(Path("part/series.json").read_text())
    state["levels"], state["complete"] = state["levels"][:2], False
    Path("part/series.json").write_text(json.dumps(state))
    assert call(*run, "-o", "part", "--resume").code == 3
    assert call(*run, "-o", "part", "--resume").code == 3
    assert call(*run, "-o", "part", "--resume", "--allow-invalid").code == 0
    pieces = re.compile(r"(_\d+)\.1(\.vts)$")
    assert [pieces.sub(r"\1\2", name) for name in files_in("part")] == before == files_in("whole")


def test_later_tables_are_checked_like_the_first(swing, call):
    """A third table in other units, and one whose points lie off the wall."""
    table = np.loadtxt("table.csv", delimiter=",")
    for number, factor in enumerate((1.0, 1.0, 1e3)):
        np.savetxt(f"move_{number}.csv", table * factor, "%.17g", delimiter=",")
    run = ("series", "grid.xyz", "-d", "move_*.csv", "--times", "0,1,2", "-o", "out", "-q")
    result = call(*run)
    assert result.code == 2
    assert "move_2.csv" in result.err
    assert "different length units" in result.err
    assert [level["number"] for level in json.loads(Path("out/series.json").read_text())["levels"]] == [0, 1]
    more = np.vstack([table, [[3.0, 3.0, 0.5, 0.1, 0.0, 0.0]] * 3 + np.eye(3, 6) * 0.01])
    np.savetxt("move_2.csv", more, "%.17g", delimiter=",")
    result = call(*run, "--force", "--report", "r.json")
    assert result.code == 0, result.err
    (warning,) = [text for text in result.warnings if "move_2.csv" in text]
    assert f"3 of {len(more)} table points lie on no face that the table moves" in warning
    levels = json.loads(Path("r.json").read_text())["levels"]
    assert [len(level["warnings"]) for level in levels] == [0, 0, 1]
    # The same doubt about every table of the sequence is told once.
    for number in range(3):
        np.savetxt(f"move_{number}.csv", more, "%.17g", delimiter=",")
    result = call(*run, "--force")
    assert sum("lie on no face" in text for text in result.warnings) == 1


STOPPED = """\
import os, signal, sys
from meshdeform_cli import main, series_run
record = series_run._record
def recorded(*given):
    record(*given)
    os.kill(os.getpid(), signal.SIGINT)
series_run._record = recorded
main.main(sys.argv[1:])
"""


@pytest.mark.parametrize("suffix", [".xyz", ".vtu"])
def test_a_signal_says_how_to_continue(swing, call, suffix):
    options = ("series", "grid.xyz", "-c", "swing.toml", "--times", "0:1:0.25", "-o", "stopped", "--suffix", suffix)
    command = [sys.executable, "-c", STOPPED, *options]
    # Shells start what runs in the background with the signal ignored.
    heard = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    stopped = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, preexec_fn=heard)
    assert stopped.returncode == 130, stopped.stderr
    advice = "1 of 5 levels are done: the same command with --resume (without --force) continues"
    assert stopped.stderr.endswith(f"meshdeform: interrupted; no output was left half-written; {advice}\n")
    assert call(*options, "--resume").code == 0


def test_a_finished_series_is_left_alone(done, call, snapshot):
    before = snapshot(Path("out"))
    assert report_of(call, *RUN, "--resume")["levels"] == done["levels"]
    assert snapshot(Path("out")) == before
    advice = "use --resume to continue it, or --force to start again"
    assert call(*RUN).error == f"meshdeform: error: out/series.json exists; {advice}\n"
    Path("out/series.json").unlink()
    for more in ((), ("--resume",)):
        told = "meshdeform: error: out/grid_0000.xyz exists; use --force to overwrite it\n"
        assert (call(*RUN, *more).code, call(*RUN, *more).error) == (2, told)
    Path("out/series.json").write_text("damaged")
    assert call(*RUN, "--force", "-q").code == 0


@pytest.mark.parametrize("deleted", [True, False])
def test_a_level_that_is_not_what_was_written_is_made_again(deleted, done, call):
    levels = {path: path.read_bytes() for path in Path("out").glob("grid*")}
    damaged = bytearray(levels[Path("out/grid_0003.xyz")])
    damaged[-1] ^= 1
    Path("out/grid_0003.xyz").write_bytes(damaged)
    if deleted:
        Path("out/grid_0003.xyz").unlink()
    Path("out/grid_0004.xyz").unlink()
    again = call(*RUN, "--resume")
    assert again.code == 0
    told = "grid_0003.xyz is not what was written: level 3 and those after it are made again"
    assert (told in again.err) is not deleted
    assert {path: path.read_bytes() for path in levels} == levels


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda: Path("swing.toml").write_text(SWING.replace("20*sin", "10*sin")), "rotate.angle was '20*sin"),
        (lambda: write_grid(read_grid("grid.xyz").moved(1.01 * read_grid("grid.xyz").points), "grid.xyz"), "grid has"),
        (("--times", "0:1:0.5"), "times was 5 values from 0.0 to 1.0, is [0.0, 0.5, 1.0]"),
        (("--set", "method.idw.alpha=0.3"), "method.idw.alpha was 0.1, is 0.3"),
        (("--repair", "off"), "repair.mode was 'auto', is 'off'"),
        (("--suffix", ".vtm"), "output was 'grid.xyz', is 'grid.vtm'"),
    ],
)  # fmt: skip
def test_a_changed_series_is_refused_with_what_changed(change, words, done, call, snapshot):
    more = change if isinstance(change, tuple) else (change(), ())[1]
    before = snapshot(Path())
    result = call(*RUN, *more, "--resume")
    assert result.code == 2
    assert "cannot continue the series in out, its inputs have changed: " in result.err
    assert words in result.err
    assert snapshot(Path()) == before


def test_formats_that_are_not_read_cannot_go_on_with_velocities(swing, call):
    options = (*RUN, "--suffix", ".vtu", "--velocity", "first", "-q")
    assert call(*options).code == 0
    Path("out/grid_0003.vtu").unlink()
    result = call(*options, "--resume")
    assert result.code == 2
    assert "cannot continue after out/grid_0002.vtu" in result.err


@pytest.mark.parametrize("suffix", [".xyz", ".foam"])
def test_levels_of_an_earlier_series_that_remain_are_told(suffix, swing, call):
    words = (*RUN, "--suffix", suffix)
    assert call(*words, "-q").code == 0
    again = call(*words, "-q", "--force")
    assert not any("earlier series" in text for text in again.warnings)
    shorter = call(*words[:-3], "0:0.5:0.25", "--suffix", suffix, "-q", "--force")
    assert shorter.code == 0
    (told,) = (text for text in shorter.warnings if "earlier series" in text)
    names = ("0.75", "1") if suffix == ".foam" else (f"grid_0003{suffix}", f"grid_0004{suffix}")
    assert told == f"levels of an earlier series remain in out, not part of this one: {', '.join(names)}"
    assert all(Path("out", name).exists() for name in names)
