"""What work on a grid asks for, and what a memory limit leaves."""

import platform
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from grids import whole_face

from meshdeform_core import memory
from meshdeform_core.grid import FileFormat, Grid, Patch, Side
from meshdeform_core.memory import Demand, MemoryLimit, deforming, passing, readable, release_freed
from meshdeform_core.parallel.scratch import resident_memory
from meshdeform_formats import write_grid
from meshdeform_formats.grids import Layout


def test_sizes_are_told_without_powers_of_ten():
    sizes = (1, 999, 1000, 1023, 1024, 1010 * 2**20, 999.4 * 2**30, 5000 * 2**40)
    expected = ["1 B", "999 B", "1000 B", "1023 B", "1 KiB", "1010 MiB", "999 GiB"]
    assert [readable(size) for size in sizes][:-1] == expected
    assert "e" not in readable(sizes[-1])


def test_what_is_set_apart_adds_up():
    left = MemoryLimit(1000, "--max-memory allows").after(300, "one").after(200, "two")
    assert (left.size, left.taken) == (500, 500)


def test_every_block_takes_memory_beside_its_nodes():
    """Of one block and of a thousand with the same nodes, in memory and in files."""
    zones = FileFormat("cgns")
    layouts = (Layout("grid.cgns", ((20, 20, 20_000 // n),) * n, zones) for n in (1, 1000))
    one, many = (Demand.of("deforming", passing(1), layout) for layout in layouts)
    assert one.what == many.what == "deforming 8,000,000 nodes"
    limit = MemoryLimit(2**32, "--max-memory allows")
    for more in (many.in_memory - one.in_memory, many.beside_files(limit) - one.beside_files(limit)):
        assert 80e6 < more < 300e6


def test_ranks_hold_the_block_that_they_fill_as_a_whole():
    grid = Layout("grid.cgns", ((200, 200, 200),), FileFormat("cgns"))
    one, half = (Demand.of("", deforming("tfi"), grid, ranks=SimpleNamespace(count=n)).in_memory for n in (1, 2))
    assert half >= one


@pytest.mark.slow
def test_what_is_asked_for_suffices_for_many_zones(tmp_path):
    """The library for HDF5 keeps the headers of all zones where its cache is large."""
    nodes = np.stack(np.meshgrid(*[np.arange(3.0)] * 3, indexing="ij"), axis=-1)
    walls = [Patch(f"p{n}-{side.label}", (whole_face((3, 3, 3), n, side),)) for n in range(500) for side in Side]
    blocks = [nodes + [3.0 * n, 0.0, 0.0] for n in range(500)]
    write_grid(Grid.from_blocks(blocks, patches=tuple(walls)), tmp_path / "zones.cgns")
    code = (
        "import sys; from meshdeform_core.memory import peak_memory; import h5py, numpy; "
        "from meshdeform_formats.grids import FORMATS, read_grid; FORMATS['cgns'].load(); before = peak_memory(); "
        "grid = read_grid(sys.argv[1]); print(grid.n_blocks, peak_memory() - before)"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "zones.cgns"], capture_output=True, check=True)
    blocks, taken = map(int, done.stdout.split())
    assert taken < 160 * 2**10 * blocks


def test_rows_of_other_ranks_do_not_count_as_data():
    """A rank reserves the whole array, of which it fills its own rows only."""
    code = "import resource; import numpy; from meshdeform_core.parallel.nodes import blank\n"
    code += "resource.setrlimit(resource.RLIMIT_DATA, (2**30, 2**30)); found = blank((2**28, 3), 'float64')\n"
    code += "found[-1] = 1.0; print(found[-1].sum(), found[0].sum())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.split() == ["3.0", "0.0"]


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of the GNU C library")
def test_freed_memory_below_a_lasting_block_returns_to_the_system(monkeypatch):
    monkeypatch.setattr(memory, "SMALL", 0)
    blocks = [np.ones(1 << 12) for _ in range(3000)]
    lasting, before = blocks[-1], resident_memory()[0]
    del blocks[:]
    release_freed()
    assert before - resident_memory()[0] > 0.8 * 3000 * lasting.nbytes
