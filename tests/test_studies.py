"""The studies and benchmarks fit the code that they examine; each study prints its table, and puts it on its page."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "studies"
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the studies are not part of the source distribution")


@pytest.fixture
def study(monkeypatch, capsys):
    """``study(name, *arguments)``: what the program prints."""
    monkeypatch.syspath_prepend(FOLDER)
    # Its modules are scripts, whose names others have, too.
    for name in [path.stem for path in FOLDER.glob("*.py")]:
        monkeypatch.delitem(sys.modules, name, raising=False)

    def told(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(FOLDER / f"{name}.py"), *map(str, arguments)])
        importlib.import_module(name).main()
        return capsys.readouterr().out

    return told


def rows(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines()]


@pytest.mark.slow
def test_large_motions_are_reached(study):
    head, _, row = rows(study("robustness_table", "--only", "valve, 65"))
    told = dict(zip(head, row, strict=True))
    assert (told["motion"], told["reached"], told["result"]) == ("valve, 65 degrees", "yes", "valid")


def test_methods_are_compared(study):
    head, _, row = rows(study("which_method", "--only", "square", "--method", "tfi", "--method", "idw"))
    assert head == ["motion", "tfi", "idw"]
    assert row[0] == "square, as it is"
    assert "**" in row[1] + row[2]


@pytest.mark.slow
def test_repaired_levels_are_smooth_and_those_of_single_runs(study):
    head, _, row = rows(study("smoothness", "--only", "airfoil"))
    told = dict(zip(head, row, strict=True))
    assert told["levels"] == told["valid"] == "41"
    assert 0 < int(told["repaired"]) == int(told["at the minimum"])
    assert float(told["with half the interval"]) < float(told["acceleration, wall steps"]) < 0.05
    # The method alone turns this grid as a whole.
    assert float(told["without a repair"]) < 1e-9 < float(told["with half the interval"])
    assert float(told["from single runs, edges"]) < 1e-6
    assert float(told["same boundary, edges"]) < 1e-6


@pytest.mark.slow
def test_a_resolved_motion_has_half_the_acceleration_with_half_the_interval(study):
    head, _, row = rows(study("jumps", "--only", "ellipse"))
    told = dict(zip(head, row, strict=True))
    assert told["not valid"] == told["told"] == "0"
    found = [float(told[name]) for name in ("acceleration, wall steps", "with 1/2 of the interval", "1/4")]
    assert 0.0 < found[2] < 0.6 * found[1] < 0.36 * found[0]
    assert float(told["back and forth, edges"]) < 1e-6
    assert float(told["single runs, edges"]) < 1e-6


def test_the_workshops_cylinder_keeps_its_affine_map_and_a_uniform_flow(study, monkeypatch):
    monkeypatch.setitem(importlib.import_module("workshop").ENDS, 1, (0.5, 0.025))
    head, _, row = rows(study("workshop", "--only", "case 1, 8 cells, idw-tfi"))
    told = dict(zip(head, row, strict=True))
    assert told["valid"] == "21 of 21"
    assert float(told["distance"]) < 1e-10
    assert told["acceleration"] == told["exact map's"]
    assert max(map(float, told["density, orders 1 / 2 / 3"].split(" / "))) < 1e-12


def test_a_table_is_put_on_its_page_row_by_row(study, tmp_path):
    """A run cut off, or of some motions only, leaves the other rows as they were."""
    page = tmp_path / "page.md"
    page.write_text("<!-- default_method.py begin -->\nold\n<!-- default_method.py end -->\n")
    keep = importlib.import_module("tables").keep
    keep([{"motion": "one", "J": 1.0}, {"motion": "two", "J": 2.0}], page, "default_method.py")
    keep([{"motion": "two", "J": 3.0}, {"motion": "three", "J": 4.0}], page, "default_method.py")
    assert rows(page.read_text())[3:-1] == [["one", "1"], ["two", "3"], ["three", "4"]]
    keep([{"motion": "four", "skew": 1.0}], page, "default_method.py")
    assert rows(page.read_text())[3:-1] == [["four", "1"]]


@pytest.mark.slow
@pytest.mark.parametrize("section", ["passes", "levels"])
def test_small_sizes_run(section, tmp_path):
    # All programs are imported by the one that runs them.
    program = FOLDER.with_name("benchmarks") / "run.py"
    command = [sys.executable, program, "--quick", "--only", section, "--json", tmp_path / "x.json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "| hemisphere" in result.stdout
