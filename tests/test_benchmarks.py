"""The benchmark programs fit the code that they measure; `make bench` runs them in full."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.slow
@pytest.mark.parametrize("section", ["passes", "levels"])
def test_small_sizes_run(section, tmp_path):
    # All programs are imported by the one that runs them.
    command = [sys.executable, FOLDER / "run.py", "--quick", "--only", section, "--json", tmp_path / "x.json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "| hemisphere" in result.stdout


def test_tables_of_the_page_are_renewed_and_nothing_else(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    # Its modules are scripts, whose names others have, too.
    for name in [path.stem for path in FOLDER.glob("*.py")]:
        monkeypatch.delitem(sys.modules, name, raising=False)
    from run import SECTIONS, renewed
    from tables import MarkdownTable

    page = (FOLDER.parent / "benchmarks" / "RESULTS.md").read_text()
    for name in SECTIONS.keys() - {"derivatives"}:
        assert page.count(f"<!-- run.py {name} begin -->") == page.count(f"<!-- run.py {name} end -->") == 1
    new = renewed(page, {"loop": [MarkdownTable("Sums", [{"pairs": 1.5}])], "derivatives": []})
    before, old, after = re.split("<!-- run.py loop (?:begin|end) -->\n", page)
    head, found, tail = re.split("<!-- run.py loop (?:begin|end) -->\n", new)
    assert (head, tail) == (before, after)
    assert found != old
    assert found.startswith("### Sums\n\n| pairs |\n|---|\n| 1.5 |\n\n*Measured on 20")


def test_a_lonely_rank_with_too_few_planes_is_told_so(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    for name in [path.stem for path in FOLDER.glob("*.py")]:
        monkeypatch.delitem(sys.modules, name, raising=False)
    from share import LonelyRank

    rows, below, above = np.arange(6.0), np.zeros(3), np.zeros(3)
    LonelyRank(1, 3).swap({0: rows, 2: rows}, {0: below, 2: above})
    assert below.tolist() == [-3.0, -2.0, -1.0]
    assert above.tolist() == [6.0, 7.0, 8.0]
    with pytest.raises(SystemExit, match=r"sends 5 rows to rank 2.*at least 6"):
        LonelyRank(1, 3).swap({0: rows, 2: rows[1:]}, {0: below, 2: above})


def test_the_box_of_a_share_is_that_of_many_blocks(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    for name in [path.stem for path in FOLDER.glob("*.py")]:
        monkeypatch.delitem(sys.modules, name, raising=False)
    from blocks import box
    from share import Box

    from meshdeform_core.parallel import Nodes

    grid = box((3, 3, 3), (4, 4, 4))
    points = Box(Nodes.of(np.empty((grid.n_nodes, 3))), 3, 4)
    np.testing.assert_array_equal(points.rows, grid.points)
