"""Words of messages, kinds of warnings, and requests to stop."""

import datetime

import pytest

from meshdeform_core import interruption
from meshdeform_core.errors import suggestion
from meshdeform_core.interruption import check, cleaned_up, continued_by, deferred, request
from meshdeform_core.wording import Notice, counted, first_of_each_kind, listed, literal, vector


def test_words():
    assert [counted(n, "block") for n in (0, 1, 1234)] == ["0 blocks", "1 block", "1,234 blocks"]
    assert [counted(n, "body", "bodies") for n in (1, 2)] == ["1 body", "2 bodies"]
    assert [listed("abcdef"), listed("abcdefg", "; ")] == ["a, b, c, d, e, f", "a; b; c; d; e; f and 1 more"]
    assert listed("abcdefgh", noun="faces") == "a, b, c, d, e, f and 2 more faces"
    assert vector((0.1 + 0.2, -0.0, -1, 1e-12)) == "(0.3, 0, -1, 1e-12)"
    assert literal({"a": [1, (2.5, "x")], "b": {}}) == "{ a = [1, [2.5, 'x']], b = {} }"
    assert literal([True, False, float("inf"), -float("inf")]) == "[true, false, infinity, -infinity]"
    assert literal([datetime.date(1979, 5, 27), datetime.time(7, 32)]) == "[1979-05-27 (a date), 07:32:00 (a time)]"
    known = "turn", "time", "tern"
    said = [suggestion("trun", known), suggestion("trun", known, 2), suggestion("x", known)]
    assert said == ["; did you mean 'turn'?", "; did you mean 'turn' or 'tern'?", ""]
    one, two, other = Notice("1 node", "nodes"), Notice("2 nodes", "nodes"), Notice("3 cells", "cells")
    assert first_of_each_kind([one, "plain", two, other, "plain"]) == [one, "plain", other]
    assert first_of_each_kind([one, "plain", other], ["plain", "nodes"]) == [other]


def test_a_request_ends_the_program_where_it_may(monkeypatch):
    for name in ("_requests", "_deferrals", "_pending", "_advice", "_raised"):
        monkeypatch.setattr(interruption, name, [])
    done, outer = [], deferred()
    with cleaned_up(lambda: done.append("outer")), pytest.raises(KeyError), cleaned_up(lambda: done.append("inner")):
        raise KeyError
    interruption.clean_up()
    assert done == ["inner", "outer"]
    outer.__enter__()
    with continued_by(lambda: "go on"):
        with continued_by(lambda: "inner"):
            assert interruption.advice() == "inner"
        with deferred():
            request(15)
            request(2)
            check()
    assert (interruption.advice(), interruption.raised()) == ("go on", False)
    with pytest.raises(SystemExit) as end:
        outer.__exit__(None, None, None)
    assert (end.value.code, interruption.requested(), interruption.raised()) == (143, 15, True)
