"""Every doubt is said: on stderr, whatever -q says, in the report, and as an error with --strict; what a user says
and nothing reads is an error or a warning."""

import json

import pytest

DOUBTFUL = ("deform", "grid.xyz", "-c", "doubtful.toml", "-o", "out.xyz", "--report", "out.json")


@pytest.fixture
def doubtful(bench):
    """A case that forgets some of the outer faces."""
    case = (bench / "case.toml").read_text()
    (bench / "doubtful.toml").write_text(case.replace('"max(abs(x), abs(y)) > 1.99"', '"x > 1.99"'))
    return bench


@pytest.mark.parametrize("options", [(), ("-q",)], ids=["loud", "quiet"])
def test_warnings_go_to_stderr_and_into_the_report(options, doubtful, call):
    result = call(*DOUBTFUL, *options)
    assert result.code == 0
    assert any("not selected by any boundary entry" in text for text in result.warnings)
    assert json.loads((doubtful / "out.json").read_text())["warnings"] == result.warnings
    assert "not selected by any boundary entry" not in result.out
    assert call("quality", "grid.xyz", "-c", "doubtful.toml", *options).warnings == result.warnings


def test_strict_refuses_and_writes_nothing(doubtful, call, snapshot):
    before = snapshot(doubtful)
    for more, told in (((), "a warning"), (("--time", "2"), "2 warnings")):
        result = call(*DOUBTFUL, "--strict", *more)
        assert (result.code, len(result.warnings)) == (2, 1 + len(more) // 2)
        assert result.error == f"meshdeform: error: {told} (see above) and --strict\n"
    assert snapshot(doubtful) == before
    series = ("series", "grid.xyz", "-c", "doubtful.toml", "--times", "0:1:0.5", "-o", "out", "--strict")
    assert call(*series).code == 2
    assert snapshot(doubtful) == before


def test_warnings_of_a_level_name_it_on_stderr_as_in_the_report(doubtful, call):
    case = doubtful / "doubtful.toml"
    case.write_text(case.read_text().replace('angle = "turn"', 'angle = "turn*t"'))
    words = ("series", "grid.xyz", "-c", "doubtful.toml", "--times", "0:1:0.25", "-o", "out", "--report", "out.json")
    result = call(*words, "-s", "constants.turn=80", "-m", "tfi", "--repair", "off", "--steps", "1", "--allow-invalid")
    assert result.warnings == json.loads((doubtful / "out.json").read_text())["warnings"]
    assert [text.startswith("level ") for text in result.warnings][:2] == [False, True]


RUN = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")


def test_time_that_the_motion_does_not_depend_on_is_a_warning(bench, call):
    assert "--time 2 has no effect" in call(*RUN, "--time", "2").err
    result = call("series", "grid.xyz", "-c", "case.toml", "--times", "0,1", "-o", "levels")
    assert any("does not depend on t" in text for text in result.warnings)


def test_motion_in_time_without_a_time_says_which_it_was(bench, call):
    case = (bench / "case.toml").read_text().replace('angle = "turn"', 'angle = "turn*(1+t)"')
    (bench / "case.toml").write_text(case)
    assert "evaluated at t = 0" in call(*RUN).err
    assert call(*RUN, "--time", "0", "--force").err == ""
    plan = json.loads(call(*RUN, "--time", "3", "--dry-run", "--json", "-q").out)
    assert plan["motion"][0]["max_rotation_deg"] == pytest.approx(40.0)
