"""Several ranks: the same grids as on one, one voice, one exit code, and nobody left waiting."""

import json
import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from grids import frame
from started_ranks import MPIEXEC, TESTS, needs_mpi, needs_mpiexec, on_ranks, start

import meshdeform as md
from meshdeform_cli.process.mpi import Place, place, run_on_ranks
from meshdeform_formats import read_grid, write_grid

FAILING = """
from meshdeform_cli.process import mpi
from meshdeform_cli.main import main
from meshdeform_core.errors import MethodError
from meshdeform_core.methods import composite
from meshdeform_core.parallel import mpi as ranks

ranks._GRACE = 0.5

def fail(*_):
    raise MethodError("made to fail")

if mpi.place().number == 1:
    composite.on_faces = fail
main()
"""
FULL_DISK = """
import errno
from meshdeform_cli import work
from meshdeform_cli.main import main

def fail(*_):
    raise OSError(errno.ENOSPC, "No space left on device", "out.xyz")

work.write_grid = fail
main()
"""
# One rank is killed, or its disk is full, when it writes its first range of planes.
UNFINISHED = """
import errno, os, signal
from meshdeform_cli.process import mpi
from meshdeform_cli.main import main
from meshdeform_formats.planes import Stored

def killed(*_):
    os.kill(os.getpid(), signal.SIGKILL)

def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device", "out.xyz")

if mpi.place().number == int(os.environ["VICTIM"]):
    Stored.write = {"killed": killed, "full": full}[os.environ["FATE"]]
main()
"""

# Arrays of more than a thousand bytes are in files; the second rank may have no room for the third of them.
IN_FILES = """
import errno, os, sys
from pathlib import Path
from meshdeform_cli.process import mpi
from meshdeform_cli.main import main
from meshdeform_core.memory import Demand
from meshdeform_core.parallel import scratch

scratch.SMALLEST = 1000
Demand.in_memory = 2**60
reserve, calls = os.posix_fallocate, []

def reserved(*given):
    calls.append(given)
    if mpi.place().number == 1 and len(calls) == int(os.environ["LAST"]):
        raise OSError(errno.ENOSPC, "No space left on device")
    reserve(*given)

os.posix_fallocate = reserved
try:
    main()
finally:
    Path(os.environ["NOTES"] + str(mpi.place().number)).write_text(str(len(calls)))
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
def test_library_in_parts(count, tmp_path, compiled):
    """The ranks compare their parts of grids and derivatives with the whole."""
    write_grid(frame(9, 8), tmp_path / "grid.xyz")
    done = on_ranks(count, tmp_path / "grid.xyz", program=(TESTS / "mpi_parts.py",))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(f"of {count} agrees") == count


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
def test_a_dry_run_in_parts_says_the_same(bench, compiled):
    args = ("deform", "grid.xyz", "-c", "case.toml", "-m", "idw-tfi", "-o", "out.xyz", "--dry-run", "-v")
    alone = start(sys.executable, "-m", "meshdeform_cli", *args)
    done = on_ranks(2, *args)
    assert (done.returncode, done.stdout) == (0, alone.stdout), done.stderr
    assert "holds the whole grid" not in done.stderr
    assert not Path("out.xyz").exists()


@needs_mpi
@pytest.mark.parametrize(
    ("method", "suffix", "reason"),
    [("idw-tfi", "xyz", ""), ("idw-rbf", "xyz", ""), ("tfi", "p3dfmt", "shared.p3dfmt is written as a whole")],
)
def test_a_rank_holds_its_part_or_says_why_not(method, suffix, reason, bench, compiled):
    args = ("deform", "grid.xyz", "-c", "case.toml", "-m", method, "--repair", "off", "-v")
    assert by_itself(*args, "-o", f"alone.{suffix}") == 0
    done = on_ranks(3, *args, "-o", f"shared.{suffix}")
    assert done.returncode == 0, done.stderr
    assert Path(f"shared.{suffix}").read_bytes() == Path(f"alone.{suffix}").read_bytes()
    assert done.stderr.count("holds the whole grid") == bool(reason)
    assert (f"the first rank alone holds the whole grid: {reason}" in done.stderr) == bool(reason)


@needs_mpi
@pytest.mark.parametrize("thick", [False, True])
def test_a_repair_gives_the_same_grid(thick, bench, compiled):
    """In parts: as a plane grid, and in space, where the ends of the span are free."""
    if thick:
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
def test_three_ranks_write_the_same_file_in_single_precision(bench, compiled):
    args = ("deform", "grid.cgns", "-c", "case.toml", "-m", "idw-tfi", "--variant", "precision=float32")
    assert by_itself(*args, "-o", "alone.cgns") == 0
    done = on_ranks(3, *args, "-o", "shared.cgns")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(read_grid("shared.cgns").points, read_grid("alone.cgns").points)


@needs_mpi
@pytest.mark.parametrize("repair", ["off", "auto"])
def test_series_is_the_same_and_can_be_continued(repair, bench, compiled):
    """In parts, with and without repairs."""
    args = ("series", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=20", "-m", "idw-tfi", "--from", "last")
    args = (*args, "--repair", repair)
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
@pytest.mark.parametrize(("suffix", "single"), [(".cgns", True), (".vtm", False)])
def test_fields_velocities_and_pictures_in_parts(suffix, single, bench, compiled):
    """As many kinds of output as a series has; the page is the same but for times, memory and names."""
    write_grid(read_grid("grid.xyz"), Path("wing.vtm"))
    args = ("series", "wing.vtm", "-c", "case.toml", "-s", "constants.turn=20", "-m", "idw-tfi", "--times", "0:2:1")
    args = (*args, "--velocity", "swept", "--suffix", suffix, *["--single-file"] * single, "-v")
    args = (*args, *(() if single else ("--field", "all")))
    assert by_itself(*args, "-o", "alone", "--report", "alone.html") == 0
    done = on_ranks(3, *args, "-o", "shared", "--report", "shared.html")
    assert done.returncode == 0, done.stderr
    assert "holds the whole grid" not in done.stderr
    one, two = ({path.relative_to(name): path for path in Path(name).rglob("*") if path.is_file()}
                for name in ("alone", "shared"))  # fmt: skip
    assert set(one) == set(two)
    for name, path in one.items():
        if path.suffix != ".json":
            assert path.read_bytes() == two[name].read_bytes(), name
    pictures = [re.findall(r'data:image/png;base64,[^"]+', Path(f"{name}.html").read_text())
                for name in ("alone", "shared")]  # fmt: skip
    # The levels of a single file cannot be read back.
    assert bool(pictures[0]) != single
    assert pictures[0] == pictures[1]


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
def test_a_block_that_does_not_fit_the_memory_is_refused_by_all(bench, snapshot):
    """The second step of idw-rbf: the rank that solves the system of a block finds that it is too large."""
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "-m", "idw-rbf", "--max-memory", "241.501MiB")
    done = on_ranks(2, *args)
    assert done.returncode == 2
    assert done.stderr.count("a radial basis function system of") == 1
    assert "MPI_ABORT" not in done.stderr
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.parametrize("suffix", ["cgns", "xyz"])
def test_ranks_work_in_files(suffix, bench, tmp_path_factory, compiled):
    notes = tmp_path_factory.mktemp("notes")
    Path("files.py").write_text(IN_FILES)
    args = ("deform", f"grid.{suffix}", "-c", "case.toml", "-m", "idw-tfi", "--repair", "off")
    assert by_itself(*args, "-o", f"alone.{suffix}") == 0
    args = (*args, "-o", f"shared.{suffix}", "--max-memory", "4GiB", "-v")
    done = on_ranks(2, *args, program=("files.py",), NOTES=f"{notes}/", LAST="0")
    assert done.returncode == 0, done.stderr
    assert "holds the whole grid" not in done.stderr
    assert all(int((notes / rank).read_text()) > 10 for rank in "01")
    assert Path(f"shared.{suffix}").read_bytes() == Path(f"alone.{suffix}").read_bytes()


@needs_mpi
@pytest.mark.parametrize("last", ["1", "8"])
def test_a_rank_without_room_for_its_files_ends_all(last, bench, tmp_path_factory, snapshot):
    """On the disk where it works."""
    Path("files.py").write_text(IN_FILES)
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--max-memory", "4GiB", "--repair", "off")
    notes = f"{tmp_path_factory.mktemp('notes')}/"
    done = on_ranks(2, *args, program=("files.py",), NOTES=notes, LAST=last)
    assert done.returncode == 2
    assert done.stderr.count("meshdeform: error: a grid larger than the memory needs a file of") == 1
    assert "No space left on device" in done.stderr
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
def test_a_file_that_cannot_be_written_ends_all(bench, snapshot):
    Path("full.py").write_text(FULL_DISK)
    before = snapshot(bench)
    done = on_ranks(2, "deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", program=("full.py",))
    assert done.returncode == 2
    assert done.stderr.count("meshdeform: error") == 1
    assert "out.xyz: No space left on device" in done.stderr
    assert "MPI_ABORT" not in done.stderr
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.parametrize("output", ["out.xyz", "out.cgns"])
@pytest.mark.parametrize("victim", ["0", "1"])
def test_a_rank_with_a_full_disk_ends_all(output, victim, bench, snapshot):
    """The ranks write one file; what one of them cannot write is the error of all."""
    Path("unfinished.py").write_text(UNFINISHED)
    Path(output).write_text("old")
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", output, "--force", "--repair", "off")
    done = on_ranks(2, *args, program=("unfinished.py",), VICTIM=victim, FATE="full")
    assert done.returncode == 2
    assert done.stderr.count("meshdeform: error") == 1
    assert f"{output}: No space left on device" in done.stderr
    assert "MPI_ABORT" not in done.stderr
    assert snapshot(bench) == before


@needs_mpi
@pytest.mark.parametrize("victim", ["0", "1"])
def test_a_killed_rank_leaves_the_old_file(victim, bench, snapshot):
    """mpiexec ends the others and says so; the next run removes what is left of the new file."""
    Path("unfinished.py").write_text(UNFINISHED)
    Path("out.xyz").write_text("old")
    before = snapshot(bench)
    args = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--force", "--repair", "off", "-q")
    done = on_ranks(2, *args, program=("unfinished.py",), VICTIM=victim, FATE="killed")
    assert done.returncode not in (0, 2, 3)
    assert done.stderr.count("(Killed)") == 1
    for left in bench.glob(".out.*.partial.xyz"):
        before[left.name] = snapshot(bench)[left.name]
    assert snapshot(bench) == before
    assert on_ranks(2, *args).returncode == 0
    assert read_grid("out.xyz").n_nodes == read_grid("grid.xyz").n_nodes
    assert not list(bench.glob(".out.*"))


@needs_mpi
def test_a_coupled_solver_hands_over_its_communicator(tmp_path, compiled):
    """The library on two ranks, without the command line: the same grid, to the bit, as on one."""
    script = TESTS.parent / "examples" / "coupling.py"
    for count in (1, 2):
        (tmp_path / str(count)).mkdir()
        done = on_ranks(count, tmp_path / str(count), "--mpi", program=(script,))
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("Step(valid") == 3 * count
    one, two = (read_grid(tmp_path / str(count) / "bent.cgns") for count in (1, 2))
    np.testing.assert_array_equal(one.points, two.points)


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


def test_ranks_that_mpi4py_does_not_see_end_the_run(monkeypatch, capsys):
    world = SimpleNamespace(COMM_WORLD=SimpleNamespace(size=1), Get_library_version=lambda: "Some MPI 5.0, of today")
    monkeypatch.setitem(sys.modules, "mpi4py", SimpleNamespace(MPI=world))
    codes = [run_on_ranks(lambda: pytest.fail("the command runs"), Place(rank, 3)) for rank in range(2)]
    assert codes == [2, 0]
    assert capsys.readouterr().err.count("mpi4py uses Some MPI 5.0, which sees 1") == 1


def test_a_plain_start_does_not_touch_mpi(bench):
    Path("mpi4py.py").write_text("raise SystemExit('imported')")
    done = start(sys.executable, "-m", "meshdeform_cli", "--version", path=bench, OMPI_COMM_WORLD_SIZE="1")
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, None),
        ({"OMPI_COMM_WORLD_RANK": "1", "OMPI_COMM_WORLD_SIZE": "4"}, Place(1, 4)),
        ({"PMI_RANK": "0", "PMI_SIZE": "2"}, Place(0, 2)),
        ({"PMIX_RANK": "5", "SLURM_STEP_NUM_TASKS": "8"}, Place(5, 8)),
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
