"""Every doubt is said: on stderr, whatever -q says, in the report, and as an error with --strict."""

from __future__ import annotations

import copy
import json
import pickle

import pytest

from meshdeform_cli.process.messages import Warnings
from meshdeform_core.errors import CaseError
from meshdeform_core.notices import Notice, first_of_each_kind, kind_of

RUN = ("deform", "grid.xyz", "-c", "doubtful.toml", "-o", "out.xyz", "--report", "out.json")


@pytest.fixture
def doubtful(bench):
    """A case that forgets some of the outer faces."""
    case = (bench / "case.toml").read_text()
    (bench / "doubtful.toml").write_text(case.replace('"max(abs(x), abs(y)) > 1.99"', '"x > 1.99"'))
    return bench


@pytest.mark.parametrize("options", [(), ("-q",)], ids=["loud", "quiet"])
def test_warnings_go_to_stderr_and_into_the_report(options, doubtful, call):
    result = call(*RUN, *options)
    assert result.code == 0
    assert any("not selected by any boundary entry" in text for text in result.warnings)
    assert json.loads((doubtful / "out.json").read_text())["warnings"] == result.warnings
    assert "not selected by any boundary entry" not in result.out


def test_strict_refuses_and_writes_nothing(doubtful, call, snapshot):
    before = snapshot(doubtful)
    result = call(*RUN, "--strict")
    assert result.code == 2
    assert result.warnings
    assert result.error == "meshdeform: error: a warning (see above) and --strict\n"
    assert snapshot(doubtful) == before


def test_strict_counts_warnings_of_the_motion_as_well(bench, call):
    result = call("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--strict", "-s", "constants.turn=0")
    assert result.code == 2
    assert "nothing moves" in result.err
    assert not (bench / "out.xyz").exists()


def test_dry_run_warns_and_is_strict_too(doubtful, call):
    plain = call("deform", "grid.xyz", "-c", "doubtful.toml", "--dry-run")
    assert plain.code == 0
    assert plain.warnings
    assert call("deform", "grid.xyz", "-c", "doubtful.toml", "--dry-run", "--strict").code == 2


def test_strict_series_stops_before_it_writes(doubtful, call, snapshot):
    before = snapshot(doubtful)
    result = call("series", "grid.xyz", "-c", "doubtful.toml", "--times", "0:1:0.5", "-o", "out", "--strict")
    assert result.code == 2
    assert snapshot(doubtful) == before


def test_warnings_of_a_level_name_it_on_stderr_as_in_the_report(doubtful, call):
    case = doubtful / "doubtful.toml"
    case.write_text(case.read_text().replace('angle = "turn"', 'angle = "turn*t"'))
    words = ("series", "grid.xyz", "-c", "doubtful.toml", "--times", "0:1:0.25", "-o", "out", "--report", "out.json")
    result = call(*words, "-s", "constants.turn=80", "-m", "tfi", "--repair", "off", "--steps", "1", "--allow-invalid")
    assert result.warnings == json.loads((doubtful / "out.json").read_text())["warnings"]
    assert [text.startswith("level ") for text in result.warnings][:2] == [False, True]


def test_quality_warns_on_stderr(doubtful, call):
    result = call("quality", "grid.xyz", "-c", "doubtful.toml", "-q")
    assert result.code == 0
    assert result.warnings


def told(capsys) -> list[str]:
    return [line.removeprefix("meshdeform: warning: ") for line in capsys.readouterr().err.splitlines()]


def test_names_with_digits_are_different_warnings(capsys):
    warnings = Warnings()
    for wall in ("wall1", "wall2", "wall1"):
        warnings.tell([f"the moved boundary crosses itself at {wall!r}"])
    assert told(capsys) == [f"the moved boundary crosses itself at {wall!r}" for wall in ("wall1", "wall2")]


def test_warnings_of_one_kind_are_told_once_whatever_their_figures(capsys):
    warnings = Warnings()
    first = Notice("walls turn by 56 degrees", "rotation of walls")
    warnings.tell([first])
    # At the end of a series, the report has the texts only.
    warnings.tell([Notice("walls turn by 58 degrees", "rotation of walls"), str(first), "another"])
    assert told(capsys) == ["walls turn by 56 degrees", "another"]


def test_strict_counts_new_kinds_only(capsys):
    warnings = Warnings(strict=True)
    with pytest.raises(CaseError, match="a warning"):
        warnings.tell([Notice("a 1", "a"), Notice("a 2", "a")])
    warnings.tell([Notice("a 3", "a")])
    assert told(capsys) == ["a 1"]


def test_a_warning_keeps_its_kind_when_it_is_copied_or_sent_to_another_process():
    warning = Notice("walls turn by 56 degrees", "rotation of walls")
    for same in (copy.deepcopy(warning), pickle.loads(pickle.dumps(warning))):
        assert (same, kind_of(same)) == (str(warning), "rotation of walls")
    assert json.dumps([warning]) == '["walls turn by 56 degrees"]'
    assert first_of_each_kind([warning, "x", "x"], ["rotation of walls"]) == ["x"]
