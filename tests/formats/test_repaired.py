"""The sentence on a repair stands on every form of the report."""

from __future__ import annotations

from meshdeform_formats.report.repaired import repair_sentence

DONE = {"cells": 12, "nodes": 1, "max_movement": 0.5, "newton_steps": 3}


def test_it_says_what_was_done_and_what_the_method_alone_gives():
    attempts = [{"repair": False, "invalid_cells": 1}, {"repair": True, "invalid_cells": 0}]
    report = {"repair": DONE, "attempts": attempts, "boundary": {"max_displacement": 2.0}}
    assert repair_sentence(report) == (
        "12 cells repaired, 1 node moved by up to 0.5 (0.25 of the largest displacement), 3 Newton steps; "
        "the method alone leaves 1 invalid cell"
    )


def test_nothing_is_said_without_a_repair_and_no_cells_are_counted_where_none_were_bad():
    assert repair_sentence({"repair": None}) == ""
    assert repair_sentence({"repair": DONE | {"cells": 0}}).startswith("weak cells improved, 1 node moved")
