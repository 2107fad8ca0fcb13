"""Several ranks: the same grids as on one, one voice, one exit code, and nobody left waiting."""

import json
import os
import sys
from pathlib import Path

import h5py
import pytest
from grids import frame
from started_ranks import MPIEXEC, TESTS, needs_mpi, needs_mpiexec, on_ranks, start

import meshdeform as md
from meshdeform_cli.process import place
from meshdeform_formats import write_grid

FAILING = """
from meshdeform_cli import process
from meshdeform_cli.main import main
from meshdeform_core.errors import MethodError
from meshdeform_core.methods import composite
from meshdeform_core.parallel import ranks

ranks._GRACE = 0.5

def fail(*_):
    raise MethodError("made to fail")

if process.place()[0] == 1:
    composite.on_faces = fail
main()
"""
# The disk of one rank is full when it writes its first range of planes, or it is killed then.
UNFINISHED = """
import errno, os, signal
from meshdeform_cli import process
from meshdeform_cli.main import main
from meshdeform_formats.planes import Stored

def full(*_):
    if "KILLED" in os.environ:
        os.kill(os.getpid(), signal.SIGKILL)
    raise OSError(errno.ENOSPC, "No space left on device", "out.xyz")

if process.place()[0] == int(os.environ["VICTIM"]):
    Stored.write = full
main()
"""


def by_itself(*args):
    return start(sys.executable, "-m", "meshdeform_cli", *args).returncode


def break_block(path: Path):
    """A CGNS file whose second block, which the second rank reads, is not what its checksum says."""
    write_grid(frame(), path)
    with h5py.File(path, "r+") as file:
        (base,) = (group for group in file.values() if "block2" in group)
        arrays = base["block2/GridCoordinates/CoordinateX"]
        values = arrays[" data"][()]
        del arrays[" data"]
        place = arrays.create_dataset(" data", data=values, chunks=values.shape, fletcher32=True)
        at = place.id.get_chunk_info(0).byte_offset
    raw = bytearray(path.read_bytes())
    raw[at] ^= 1
    path.write_bytes(raw)


@needs_mpi
@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_interface_of_idwarp(count, tmp_path):
    """A distributed solver with split zones; the last of three ranks has none."""
    md.write(md.sample("wing", "small").grid, tmp_path / "wing.cgns")
    done = on_ranks(count, tmp_path / "wing.cgns", program=(TESTS / "mpi_idwarp.py",))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(f"of {count} agrees") == count


@needs_mpi
def test_openmdao_components(tmp_path, monkeypatch):
    """Products of two ranks together against those of one process."""
    pytest.importorskip("openmdao")
    pytest.importorskip("mphys")
    monkeypatch.chdir(tmp_path)
    done = on_ranks(2, program=(TESTS / "mpi_openmdao.py",))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("of 2 agrees") == 2


@needs_mpi
def test_command_writes_the_same_file_and_speaks_once(bench, compiled):
    turned = ("-s", "constants.turn=75", "--repair", "off", "--allow-invalid")
    args = ("deform", "grid.xyz", "-c", "case.toml", "-m", "idw-tfi", *turned, "-v")
    assert by_itself(*args, "-o", "alone.xyz", "--report", "alone.json") == 0
    done = on_ranks(2, *args, "-o", "shared.xyz", "--report", "shared.json")
    assert done.returncode == 0, done.stderr
    assert Path("shared.xyz").read_bytes() == Path("alone.xyz").read_bytes()
    one, two = (json.loads(Path(name).read_text()) for name in ("alone.json", "shared.json"))
    assert two["quality"] == one["quality"]
    assert two["invalid_cells"] == one["invalid_cells"]
    assert two["invalid_cells"]
    assert done.stdout.count("verdict") == 1
    assert done.stderr.count("cells became invalid") == 1
    assert "meshdeform: 2 ranks" in done.stderr


@needs_mpi
def test_ranks_with_different_inputs_are_refused(bench, snapshot):
    text = (bench / "case.toml").read_text()
    (bench / "other.toml").write_text(text + "\n# changed\n")
    words = [(sys.executable, "-m", "meshdeform_cli", "deform", "grid.xyz", "-c", case, "-o", "old.xyz", "--force")
             for case in ("case.toml", "other.toml")]  # fmt: skip
    done = start(MPIEXEC, "-n", "1", *words[0], ":", "-n", "1", *words[1])
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("rank 1 has other inputs than rank 0: other.toml differs from case.toml") == 1


@needs_mpi
def test_a_repair_gives_the_same_grid(bench, compiled):
    """In parts, in space: the ends of the span are free."""
    case = Path("case.toml").read_text()
    Path("case.toml").write_text(case.replace('kind = "slip"', 'kind = "free"'))
    args = ("deform", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=100", "--steps", "1", "-v")
    assert by_itself(*args, "-o", "alone.xyz", "--report", "alone.json") == 0
    done = on_ranks(2, *args, "-o", "shared.xyz", "--report", "shared.json")
    assert done.returncode == 0, done.stderr
    one, two = (json.loads(Path(name).read_text())["repair"] for name in ("alone.json", "shared.json"))
    assert one["newton_steps"] > 0
    assert {**one, "seconds": 0} == {**two, "seconds": 0}
    assert "holds the whole grid" not in done.stderr
    assert Path("shared.xyz").read_bytes() == Path("alone.xyz").read_bytes()


@needs_mpi
def test_series_is_the_same_and_can_be_continued(bench, compiled):
    args = ("series", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=20", "-m", "idw-tfi")
    assert by_itself(*args, "--times", "0:2:1", "-o", "alone") == 0
    for resumed in ((), ("--resume",)):
        done = on_ranks(2, *args, "--times", "0:2:1", "-o", "shared", *resumed)
        assert done.returncode == 0, done.stderr
        levels = sorted(path.name for path in Path("alone").glob("*.xyz"))
        assert len(levels) == 3
        assert sorted(path.name for path in Path("shared").iterdir()) == sorted(os.listdir("alone"))
        for name in levels:
            assert Path("shared", name).read_bytes() == Path("alone", name).read_bytes()
        # The second time around the last two levels are missing.
        for name in levels[1:]:
            Path("shared", name).unlink()


@needs_mpi
@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("deform", "gone.xyz", "-c", "case.toml", "-o", "out.xyz"), "gone.xyz does not exist"),
        (("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz"), "old.xyz exists"),
        (("deform", "broken.p3dfmt", "-c", "case.toml", "-o", "out.xyz"), "found 'oops'"),
        (("deform", "broken.cgns", "-c", "case.toml", "-o", "out.xyz"), "cannot read broken.cgns as HDF5"),
        (("info", "grid.xyz"), "'info' cannot run on several ranks"),
    ],
)
def test_what_is_wrong_is_said_once(args, message, bench, snapshot):
    Path("broken.p3dfmt").write_text(Path("grid.p3dfmt").read_text().rstrip() + " oops\n")
    break_block(Path("broken.cgns"))
    before = snapshot(bench)
    done = on_ranks(2, *args)
    assert done.returncode == 2
    assert done.stderr.count(message) == 1
    assert "MPI_ABORT" not in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.slow
def test_ranks_keep_to_their_memory(bench, compiled):
    """Half of six million nodes takes more in memory than is allowed."""
    write_grid(frame(110, 58), "large.xyz")
    args = ("deform", "large.xyz", "-c", "case.toml", "-m", "idw-tfi", "--repair", "off", "--allow-invalid")
    assert by_itself(*args, "-o", "alone.xyz") == 0
    done = on_ranks(2, *args, "-o", "shared.xyz", "--max-memory", "900MiB", "--report", "shared.json")
    assert done.returncode == 0, done.stderr
    assert json.loads(Path("shared.json").read_text())["peak_memory_bytes"] < 900 * 2**20
    assert Path("shared.xyz").read_bytes() == Path("alone.xyz").read_bytes()


@needs_mpi
def test_a_rank_that_fails_alone_ends_all(bench, snapshot):
    Path("failing.py").write_text(FAILING)
    before = snapshot(bench)
    done = on_ranks(2, "deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", program=("failing.py",))
    assert done.returncode == 2
    assert done.stderr.count("rank 1 of 2: meshdeform: error: made to fail") == 1
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.parametrize(("output", "victim"), [("out.xyz", "0"), ("out.cgns", "1")])
def test_a_rank_with_a_full_disk_ends_all(output, victim, bench, snapshot):
    """The ranks write one file; what one of them cannot write is the error of all."""
    Path("unfinished.py").write_text(UNFINISHED)
    Path(output).write_text("old")
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", output, "--force", "--repair", "off")
    done = on_ranks(2, *args, program=("unfinished.py",), VICTIM=victim)
    assert done.returncode == 2
    assert done.stderr.count("meshdeform: error") == 1
    assert f"{output}: No space left on device" in done.stderr
    assert "MPI_ABORT" not in done.stderr
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.parametrize("victim", ["0", "1"])
def test_a_rank_that_is_killed_ends_all_and_leaves_the_old_file(victim, bench, call):
    Path("unfinished.py").write_text(UNFINISHED)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz", "--force", "--repair", "off")
    done = on_ranks(3, *args, program=("unfinished.py",), VICTIM=victim, KILLED="1")
    assert done.returncode not in (0, 2, 3)
    assert "Traceback" not in done.stderr
    assert Path("old.xyz").read_bytes() == b"an old result"
    # The next run removes what the killed one left.
    assert call(*args).code == 0
    assert not list(Path().glob(".*.partial*"))


@needs_mpiexec
def test_without_mpi4py_nothing_is_written(bench, snapshot, tmp_path):
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "mpi4py.py").write_text("raise ImportError('No module named mpi4py')")
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
    done = on_ranks(2, *args, path=tmp_path / "hidden")
    assert done.returncode == 2
    assert done.stderr.count("pip install mpi4py") == 1
    assert snapshot(bench) == before


@needs_mpi
def test_the_mpiexec_of_another_mpi_is_refused(bench, snapshot):
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
    done = start(sys.executable, "-m", "meshdeform_cli", *args, PMI_RANK="0", PMI_SIZE="3")
    assert done.returncode == 2
    assert "sees 1; use the mpiexec of that MPI" in done.stderr
    assert snapshot(bench) == before


def test_a_plain_start_does_not_touch_mpi(bench):
    Path("mpi4py.py").write_text("raise SystemExit('imported')")
    done = start(sys.executable, "-m", "meshdeform_cli", "--version", path=bench, OMPI_COMM_WORLD_SIZE="1")
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, None),
        ({"OMPI_COMM_WORLD_RANK": "1", "OMPI_COMM_WORLD_SIZE": "4"}, (1, 4)),
        ({"PMI_RANK": "0", "PMI_SIZE": "2"}, (0, 2)),
        ({"PMIX_RANK": "5", "SLURM_STEP_NUM_TASKS": "8"}, (5, 8)),
        ({"PMI_RANK": "0", "PMI_SIZE": "1"}, None),
        ({"SLURM_STEP_NUM_TASKS": "8"}, None),
        ({"PMI_RANK": "", "PMI_SIZE": "many"}, None),
    ],
)
def test_launchers_are_known_by_their_variables(variables, expected, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("OMPI_", "PMI", "SLURM_")):
            monkeypatch.delenv(name)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert place() == expected
