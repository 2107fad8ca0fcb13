"""The benchmark programs fit the code that they measure; `make bench` runs them in full."""

import re
import subprocess
import sys
from pathlib import Path

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
