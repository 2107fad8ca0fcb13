"""What work on a grid asks for, and what a memory limit leaves."""

import platform
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from meshdeform_core import memory
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.grid import FileFormat
from meshdeform_core.memory import UNLIMITED, Demand, MemoryLimit, deforming, parse_memory, passing
from meshdeform_core.parallel.scratch import resident_memory
from meshdeform_formats.grids import Layout


def test_sizes_are_told_without_powers_of_ten():
    sizes = (1, 999, 1000, 1023, 1024, 999.6 * 2**20, 999.4 * 2**30, 5000 * 2**40)
    expected = ["1 B", "999 B", "1000 B", "1023 B", "1 KiB", "1000 MiB", "999 GiB"]
    assert [memory.readable(size) for size in sizes][:-1] == expected
    assert "e" not in memory.readable(sizes[-1])


def test_what_is_set_apart_adds_up():
    left = MemoryLimit(1000, "--max-memory allows").after(300, "one").after(200, "two")
    assert (left.size, left.taken) == (500, 500)
    left.require(500, "all", "less")
    said = "a sum needs about 504 B, --max-memory allows, after 300 B for one,, after 200 B for two, 500 B; take less"
    with pytest.raises(MethodError, match=f"^{said}$"):
        left.require(501, "a sum", "take less")
    assert left.after(600, "three").size == 0


def test_a_limit_is_a_size_with_its_unit():
    known = {"2GiB": 2**31, "500 MB": 5e8, "10": 10, " 1.5kb ": 1500, "3T": 3e12, "1kib": 1024, "7b": 7, "4gb": 4e9}
    for text, size in known.items():
        assert parse_memory(text, "--max-memory") == MemoryLimit(size, "--max-memory allows")
    for text in ("0", "-1GB", "2XB", "1.GiB", "nan", "9" * 400, "2 G iB"):
        with pytest.raises(CaseError, match=rf"^-m '{text}': expected a size like 2GiB, 500MB or 1000000 \(bytes\)$"):
            parse_memory(text, "-m")


# Largest resident size in MB: `deform --repair off` on boxes of 1 to 1,000 cubes with so many nodes along each edge;
# two sides slip, one moves, the others are fixed.
MEASURED = (
    ("tfi", 1, 67, 197), ("tfi", 1, 87, 232), ("tfi", 1, 126, 361), ("tfi", 1, 271, 1691), ("tfi", 1000, 13, 446),
    ("idw", 1, 126, 376), ("idw-tfi", 1, 67, 205), ("idw-tfi", 1, 271, 1557), ("idw-tfi", 10, 126, 1654),
    ("idw-tfi", 1000, 9, 318), ("idw-tfi", 1000, 27, 1869), ("rbf", 1, 67, 327),
)  # fmt: skip


def boxes(method: str, blocks: int, side: int, **more) -> Demand:
    layout = Layout("grid.xyz", ((side,) * 3,) * blocks, FileFormat("plot3d"))
    return Demand.of("deforming", deforming(method), layout, **more)


@pytest.mark.parametrize(("method", "blocks", "side", "peak"), MEASURED)
def test_memory_is_foretold(method, blocks, side, peak):
    """Few large blocks take most while nodes move, many small ones while the faces of the result are judged."""
    sources = 4 * side**2 if method == "rbf" else 0
    demand = boxes(method, blocks, side)
    assert demand.foretold(UNLIMITED, sources) == (pytest.approx(1e6 * peak, rel=0.15), 0)
    assert demand.foretold(MemoryLimit(demand.in_memory, "all"), 10**6) == (demand.in_memory, 0)


def test_what_fits_is_kept_in_memory():
    """A grid of 666,057 nodes takes less than 300 MiB, one of 20 million less than 4 GiB."""
    assert deforming("other") == deforming("other-tfi") == deforming("rbf-tfi") == deforming("idw-rbf")
    assert 232e6 < boxes("tfi", 1, 87).in_memory < 300 * 2**20
    assert 1.6e9 < boxes("idw-tfi", 1, 271).in_memory < 2e9
    more = boxes("idw-tfi", 1, 271, data=10**9).in_memory - boxes("idw-tfi", 1, 271).in_memory
    assert 3e9 < more < 4e9
    # Fields take more than all that is before them; velocities are held beside it.
    stages, held = zip(*(deforming("tfi", *given) for given in ((), (True,), (False, 48), (True, 96))), strict=True)
    assert [len(each) for each in stages] == [2, 3, 2, 3]
    assert (held[0], held[1], held[3] - held[2]) == (0, 0, 48)
    assert held[2] == pytest.approx(132 + 48, rel=0.05)


@pytest.mark.parametrize(
    ("blocks", "side", "cap", "peak"),
    [(1, 229, 1000, 682), (1, 271, 1024, 709), (10, 271, 4096, 2864), (1000, 58, 4096, 3056)],
)
def test_what_files_take_is_foretold(blocks, side, cap, peak):
    """Largest resident size in MB, measured with ``idw-tfi`` under a limit in MiB, and room on the disk."""
    resident, files = boxes("idw-tfi", blocks, side).foretold(parse_memory(f"{cap}MiB", "--max-memory"), 0)
    assert resident == pytest.approx(1e6 * peak, rel=0.15)
    # 624 MB were measured of 12 million nodes.
    assert files == pytest.approx(52 * blocks * side**3, rel=0.1)


@pytest.mark.parametrize(("method", "peak"), [("idw-tfi", 577), ("tfi", 1138)])
def test_ranks_are_told_what_each_of_them_takes(method, peak):
    """MB that the largest of four took with 12 million nodes in one block, which ``tfi`` fills as a whole."""
    layouts = (Layout("grid.xyz", (shape,), FileFormat("plot3d")) for shape in ((3, 3, 3), (229,) * 3))
    demand = Demand.of("deforming", deforming(method), *layouts, ranks=SimpleNamespace(count=4))
    assert 0.98 < demand.in_memory / (1e6 * peak) < 1.15


def test_every_block_takes_memory_beside_its_nodes():
    """Of one block and of a thousand with the same nodes, in memory and in files."""
    zones = FileFormat("cgns")
    layouts = (Layout("grid.cgns", ((20, 20, 20_000 // n),) * n, zones) for n in (1, 1000))
    one, many = (Demand.of("deforming", passing(1), layout) for layout in layouts)
    assert one.what == many.what == "deforming 8,000,000 nodes"
    limit = MemoryLimit(2**32, "--max-memory allows")
    for more in (many.in_memory - one.in_memory, many.beside_files(limit) - one.beside_files(limit)):
        assert 80e6 < more < 300e6


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
    memory.release_freed()
    assert before - resident_memory()[0] > 0.8 * 3000 * lasting.nbytes
