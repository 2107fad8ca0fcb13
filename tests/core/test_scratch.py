"""Large arrays in files mapped into memory: the same results, nothing left behind, a full disk found in time."""

import errno
import gc
import mmap
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace

import numpy as np
import pytest
from cases import body_specs, turning
from forked_ranks import ForkedRank, on_ranks
from grids import frame

from meshdeform_core.deform import Case, deform
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid
from meshdeform_core.memory import Amounts, Demand, MemoryLimit, deforming, machine_memory
from meshdeform_core.methods import Options
from meshdeform_core.parallel import current_sharing, empty, scratch, sharing
from meshdeform_core.parallel.scratch import Scratch

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="mapped files are watched on Linux only")


def lies_in_a_file(array):
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(getattr(array, "obj", array), mmap.mmap)


def deformed(method, steps):
    start = frame(9, 5)
    grid = Grid.from_blocks([start.block(b) for b in range(start.n_blocks)], start.names)
    return deform(grid, Case(body_specs(turning(20)), method=Options(method)), steps=steps)


@pytest.mark.parametrize(("method", "steps"), [("idw-tfi", 2), ("rbf-tfi", "auto")])
def test_results_do_not_depend_on_where_arrays_lie(method, steps, tmp_path, monkeypatch):
    expected = deformed(method, steps)
    monkeypatch.setattr(scratch, "SMALLEST", 1000)
    # With a limit of one byte all pages are returned at every look.
    with sharing(scratch=Scratch(tmp_path, 1)):
        found = deformed(method, steps)
    assert lies_in_a_file(found.setup.grid.points)
    assert lies_in_a_file(found.grid.points)
    assert not lies_in_a_file(expected.grid.points)
    assert found.grid.points.tobytes() == expected.grid.points.tobytes()
    assert found.assessment == expected.assessment
    assert os.listdir(tmp_path) == []


def test_files_vanish_with_their_arrays(tmp_path, monkeypatch):
    monkeypatch.setattr(scratch, "SMALLEST", 1000)
    where = Scratch(tmp_path, 1)
    with sharing(scratch=where):
        array = empty((1000, 3))
        assert not lies_in_a_file(empty((10, 3)))
    array[:] = 7.0
    where.look()
    assert (array == 7.0).all()
    del array
    gc.collect()
    end = time.monotonic() + 10.0
    while where._watched and time.monotonic() < end:
        time.sleep(0.01)
    assert not where._watched
    assert all(each() is None for each in where._maps)


def test_a_full_disk_is_found_before_anything_is_computed(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with (
        sharing(scratch=Scratch(tmp_path, 1)),
        pytest.raises(MethodError, match=r"needs a file of 0\.0224 GiB in .*No sp"),
    ):
        empty((10**6, 3))


def test_what_a_method_may_take_beside_the_files(tmp_path):
    nodes, limit = 10**8, MemoryLimit(4 * 2**30, "--max-memory allows")

    def demand(face_nodes):
        return Demand("deforming 100,000,000 nodes", deforming("idw-tfi"), Amounts(1, nodes, face_nodes))

    with pytest.raises(MethodError, match=r"deforming 100,000,000 nodes needs about 6\.\d+ GiB"):
        demand(0).place(limit, None)
    with sharing(scratch=Scratch(tmp_path, 1)):
        demand(0).place(MemoryLimit(2**40, "the machine has"), tmp_path)
        assert current_sharing().scratch is None
        demand(2 * 10**6).place(limit, tmp_path)
        assert current_sharing().scratch is not None
        left = demand(2 * 10**6).left_of(limit)
        assert 2 * 2**30 < left.size < 3 * 2**30
        with pytest.raises(MethodError, match=r"needs about \d\.\d+ GiB, --max-memory allows 4 GiB"):
            demand(6 * 10**7).place(limit, tmp_path)


def placed(tmp_path, lacking, on_machine):
    """What three ranks find who place a grid, and where; ``lacking`` ranks have no room on their disk."""

    def act(ranks):
        limit = MemoryLimit(4 * 2**30, "--max-memory allows", ranks=ranks)
        own = tmp_path / str(ranks.number)
        own.mkdir()
        free = 2**20 if ranks.number in lacking else 2**50
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(ForkedRank, "on_machine", on_machine)
            patch.setattr(tempfile, "tempdir", str(own))
            patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
            try:
                Demand("deforming 2e8 nodes", deforming("idw-tfi"), Amounts(1, 8 * 10**7)).place(limit, tmp_path)
            except MethodError as error:
                return str(error)
        placed = current_sharing().scratch
        return placed.empty((3,), "int8") is not None and placed._folder

    return on_ranks(3, act)


def test_ranks_work_beside_the_output_or_each_on_a_disk_of_its_machine(tmp_path):
    assert placed(tmp_path, (), 3) == [tmp_path] * 3
    other = tmp_path / "other"
    other.mkdir()
    assert placed(other, (), 1) == [other / str(number) for number in range(3)]


def test_ranks_of_one_machine_share_its_memory(monkeypatch):
    monkeypatch.setattr(ForkedRank, "on_machine", 3)
    (share,) = set(on_ranks(3, lambda ranks: machine_memory(ranks).size))
    assert 2 * share < machine_memory().size


def test_a_disk_without_room_on_one_machine_is_the_error_of_all_ranks(tmp_path):
    (message,) = set(placed(tmp_path, (1, 2), 1))
    expected = f"needs files of 3.87 GiB to work in; the disk of {tmp_path / '1'} of {platform.node()} has 1 MiB free"
    assert expected in message
    other = tmp_path / "other"
    other.mkdir()
    (message,) = set(placed(other, (0, 1, 2), 3))
    assert f"needs files of 11.6 GiB for 3 ranks to work in; the disk of {other} has 1 MiB free" in message


STARTS = """
import sys
from pathlib import Path
import numpy as np
from meshdeform_core.parallel import empty, for_chunks, loops, nodes, scratch
from meshdeform_formats import read_grid
from meshdeform_core.grid.planes import block_extents

# Every thread brings in pages of its own.
loops.set_sharing(threads=2)

class Unwatched(scratch.Scratch):
    # Pages are released by the loops alone; what they bring in between two looks is recorded.
    most = 0
    def blank(self, *rest):
        self._watched = True
        return super().blank(*rest)
    def look(self):
        self.most = max(self.most, scratch.resident_memory()[1])
        super().look()
"""

READING = """
n, count = 50, 32
file = Path(sys.argv[1]) / "grid.p3dbin"
with file.open("wb") as out:
    np.array([count, *(n,) * 3 * count], "<i4").tofile(out)
    np.random.default_rng(0).uniform(size=3 * count * n**3).tofile(out)
nodes._STRETCHES = 8
used = Unwatched(Path(sys.argv[1]), 1)
used._full = used._files = 0
loops.set_sharing(scratch=used)
before = scratch.resident_memory()[1]
grid = read_grid(file)
block_extents(grid)
grid.total_of(grid.points)
print((used.most - before) // 2**20)
"""

FREE_MEMORY = """
used = Unwatched(Path(sys.argv[1]), 2**40)
used._files = 200 * 2**20
loops.set_sharing(scratch=used)
array = empty((1 << 24, 3))
for_chunks(lambda lo, hi: array[lo:hi].fill(1.0), len(array), 1 << 18)
print(used.most // 2**20, scratch.Scratch(Path(), 2**32)._files // 2**20)
"""


def printed(code, folder):
    done = subprocess.run([sys.executable, "-c", STARTS + code, str(folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [int(word) for word in done.stdout.split()]


def test_reading_brings_few_pages_into_memory_at_a_time(tmp_path):
    """A sample of nodes taken all at once would bring in the whole grid, 92 MiB, and so would sums without looks."""
    (most,) = printed(READING, tmp_path)
    assert most < 50


def test_files_do_not_fill_free_memory(tmp_path):
    """Of an array of 384 MiB only as much stays in memory as is allowed for files."""
    most, allowed = printed(FREE_MEMORY, tmp_path)
    assert most < 260
    assert allowed == 1024
