"""What a dry run foretells is what the run then meets."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    from meshdeform_cli.main import run

    folder = tmp_path_factory.mktemp("plate")
    assert run(["sample", "splitter-plate", "-o", str(folder), "--size", "8"]) == 0
    return folder


@pytest.fixture
def both(plate, call, tmp_path):
    """Warnings of a dry run about the trial, and the exit code and report of the run."""

    def called(*options: str) -> tuple[list[str], int, dict]:
        command = ("deform", plate / "grid.cgns", "-c", plate / "case.toml", *options, "-m", "tfi")
        dry = call(*command, "--dry-run")
        assert dry.code == 0, dry.err
        assert list(tmp_path.iterdir()) == []
        real = call(*command, "-o", tmp_path / "out.cgns", "--report", tmp_path / "out.json", "-q")
        report = json.loads((tmp_path / "out.json").read_text()) if real.code in (0, 3) else {}
        return dry.warnings, real.code, report

    return called


def test_a_motion_that_works_gets_no_warning(both):
    warnings, code, _ = both("-s", "constants.angle=5", "--repair", "off")
    assert (warnings, code) == ([], 0)


@pytest.mark.parametrize("steps", [(), ("--steps", "3")], ids=["one", "three"])
def test_what_fails_without_repair_is_counted(steps, both):
    """60 degrees on the splitter plate."""
    warnings, code, report = both("-s", "constants.angle=60", "--repair", "off", *steps)
    assert code == 3
    cells = report["quality"]["after"]["invalid_cells"]
    (told,) = [text for text in warnings if text.startswith("tried with tfi")]
    assert f"in {(len(steps) and 3) or 1} step" in told
    assert f": {cells} cells become invalid" in told
    assert "without repair the run is bound to fail" in told
    assert f"worst {report['invalid_groups'][0]['block']}" in told


def test_with_repair_it_says_what_will_be_done(both):
    warnings, code, report = both("-s", "constants.angle=45")
    (told,) = [text for text in warnings if text.startswith("tried with tfi")]
    assert "the run will repair them, then smaller steps, which takes longer and may fail" in told
    assert f": {report['attempts'][0]['invalid_cells']} cells become invalid" in told
    assert code in (0, 3)


def test_an_amplitude_larger_than_the_domain_is_impossible(plate, call):
    command = ("deform", plate / "grid.cgns", "-c", plate / "case.toml", "-m", "tfi", "-s", "constants.amplitude=200")
    result = call(*command, "--dry-run")
    assert any("crosses itself, so no valid grid exists" in text for text in result.warnings)
    assert result.code == 3
    assert any("no repair can mend that" in text for text in result.warnings)
    assert call(*command, "--dry-run", "--strict").code == 2


def test_of_a_series_the_worst_level_is_tried(plate, call):
    case = (plate / "case.toml").read_text().replace('angle = "angle"', 'angle = "angle*t"')
    Path(plate / "moving.toml").write_text(case)
    command = ("series", plate / "grid.cgns", "-c", plate / "moving.toml", "-m", "tfi", "--repair", "off")
    result = call(*command, "--times", "0:2:1", "-o", plate / "out", "--dry-run")
    assert any(text.startswith("at t = 2, where the displacement is largest: tried") for text in result.warnings)
    assert not call(*command, "--times", "0:0.2:0.1", "-o", plate / "out", "--dry-run").warnings
