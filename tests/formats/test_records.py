"""Records of reports hold what the results hold, in types of JSON."""

from __future__ import annotations

import dataclasses
import json
import tomllib

import numpy as np
import pytest
from grids import CASE, frame

from meshdeform_core.deform import deform, set_up
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.series import Schedule, deform_series
from meshdeform_formats.case import case_of
from meshdeform_formats.report.records import (
    deformation_report,
    level_record,
    quality_report,
    series_head,
    series_report,
    with_other,
)

BROKEN = tomllib.loads(CASE.replace("turn = 10.0", "turn = 120.0").replace('"turn"', '"turn*(1 + t)"'))
BROKEN |= {"method": {"name": "tfi"}, "repair": {"mode": "off"}}


@pytest.fixture(scope="module")
def setup():
    return set_up(frame(), case_of(BROKEN).case)


def test_a_deformation(setup):
    result = deform(setup.grid, setup.case)
    report = deformation_report(result, {"read": 1.5, "other": 2.0}, 7)
    assert report["grid"] == {"file": None, "format": None, "dimension": 3, "blocks": 8, "nodes": 1152, "cells": 600}
    counts = {"moving": 80, "fixed": 240, "slip": 320, "interface": 64, "interior": 256}
    assert {key: n for key, n in report["boundary"].items() if key.endswith("_nodes")} == {
        f"{kind}_nodes": n for kind, n in counts.items()
    }
    assert report["boundary"]["patches"] == [
        {"name": "body", "kind": "moving", "nodes": 80}, {"name": "span", "kind": "slip", "nodes": 480},
        {"name": "outer", "kind": "fixed", "nodes": 240},
    ]  # fmt: skip
    assert report["boundary"]["max_displacement"] == pytest.approx(2 * np.sqrt(0.5) * np.sin(np.radians(60)))
    (motion,) = report["motion"]
    assert (motion["boundary"], motion["max_rotation_deg"]) == ("body", pytest.approx(120))
    settings = {key: setting.value for key, setting in result.account.settings.items()}
    assert {key: part["value"] for key, part in report["method"].items() if key != "name"} == settings
    own = result.assessment
    assert report["quality"] == {"before": dataclasses.asdict(own.before), "after": dataclasses.asdict(own.after),
                                 "change": own.change}  # fmt: skip
    assert (report["valid"], report["steps"], report["reached"], report["repair"]) == (False, 1, 1.0, None)
    assert report["attempts"] == [dataclasses.asdict(attempt) for attempt in result.attempts]
    assert len(report["invalid_cells"]) == len(own.invalid) > 20
    for cell, found in zip(own.invalid, report["invalid_cells"], strict=True):
        assert found == dataclasses.asdict(cell) | {"ijk": list(cell.ijk), "center": list(cell.center)}
    assert set(report["timing"]) >= {"read", "topology", "prepare", "apply", "quality", "write"}
    assert (report["timing"]["read"], report["timing"]["write"], report["peak_memory_bytes"]) == (1.5, 0.0, 7)
    assert (report["warnings"], "components" in report) == (list(result.warnings), False)
    json.dumps(report)
    report = quality_report(result.grid, own, ("a", "b"), "old.xyz", setup.grid)
    shapes = [{name: dataclasses.asdict(m) for name, m in shape_measures(g).items()} for g in (setup.grid, result.grid)]
    assert report["shape"] == {"before": shapes[0], "after": shapes[1]}
    assert (report["reference"], report["warnings"], report["valid"]) == ("old.xyz", ["a", "b"], False)
    assert quality_report(setup.grid, own, ())["shape"]["before"] is None


def test_a_series(setup):
    schedule = Schedule((0.0, 0.1))
    levels = list(deform_series(setup, schedule, "float64"))
    head = series_head(levels[0])
    records = [level_record(level, f"{level.number}.xyz", 0.25, head, ["doubt"][: level.number]) for level in levels]
    for level, record in zip(levels, records, strict=True):
        own = level.result
        assert (record["number"], record["time"], record["file"]) == (level.number, level.time, f"{level.number}.xyz")
        assert record["max_displacement"] == own.max_displacement
        assert record["max_rotation_deg"] == pytest.approx(120 * (1 + level.time))
        assert record["quality"] == dataclasses.asdict(own.assessment.after)
        assert (len(own.assessment.invalid) > 20, len(record["invalid_cells"])) == (True, 20)
        assert record["timing"]["total"] == pytest.approx(0.25 + sum(own.timing.seconds.values()))
        assert set(record["smoothness"]) == {"velocity", "acceleration", "acceleration_in_edges"}
        # The method is that of the head.
        assert record["method"] == {}
    assert head["quality"] == {"before": dataclasses.asdict(levels[0].result.assessment.before)}
    report = series_report(head, records, schedule, {"folder": "out", "view": None}, {"read": 2.0}, 7)
    assert report["series"] == {"levels": 2, "velocity": schedule.velocity, "folder": "out", "view": None}
    assert (report["valid"], report["timing"]["read"], report["timing"]["write"]) == (False, 2.0, 0.5)
    assert report["boundary"]["max_displacement"] == max(level.result.max_displacement for level in levels)
    assert report["warnings"] == [*head["warnings"], "level 1: doubt"]
    still = [record | {"max_displacement": 0.0, "valid": n == 1, "warnings": []} for n, record in enumerate(records)]
    report = series_report(head, still, schedule, {}, {}, 7)
    assert (report["valid"], report["warnings"][-1]) == (False, "nothing moves: the displacement is zero at all levels")


def test_stages_add_up_to_the_total():
    assert with_other({"read": 1.0, "other": 9.0, "total": 9.0}, 3.5) == {"read": 1.0, "other": 2.5, "total": 3.5}
    assert with_other({"read": 4.0}, 3.5) == {"read": 4.0, "other": 0.0, "total": 4.0}
