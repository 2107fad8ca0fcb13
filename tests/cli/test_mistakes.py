"""Mistakes of newcomers, each with the first line of the message that it gets."""

from __future__ import annotations

import numpy as np
import pytest

import meshdeform as md
from meshdeform_core.errors import MotionError
from meshdeform_formats.report.text import axis_text
from meshdeform_formats.wording import counted

DEFORM = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")

MISTAKES = {
    "command": (("deforn", "grid.xyz"), "No such command 'deforn'; did you mean 'deform'?"),
    "method": ((*DEFORM, "-m", "idv"), "--method idv: method 'idv' is unknown; known are "),
    "constant": ((*DEFORM, "-s", "turn=10"), "--set 'turn=10': unknown key 'turn'; did you mean 'constants.turn'?"),
    "option of another command": (("quality", "grid.xyz", "-m", "tfi"), "No such option '-m'"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_the_message_names_the_mistake(name, bench, call):
    arguments, message = MISTAKES[name]
    result = call(*arguments)
    assert result.code == 2
    assert message in result.err


def test_a_function_of_the_points_alone_is_refused_as_a_motion():
    mesh = md.prepare(md.sample("beam", 40).grid, moving=["beam"])
    with pytest.raises(MotionError, match=r"displacement is a function\(points\); expected one of \(points, time\)"):
        mesh.deform(lambda points: 0.0 * points)
    assert mesh.deform(lambda points, time: np.zeros_like(points)).valid


def test_the_axis_of_a_rotation_is_told():
    assert axis_text([0.0, 0.0, 1.0]) == " about +z"
    assert axis_text([0.0, -1.0, 1e-3]) == " about -y"
    assert axis_text([0.6, 0.0, 0.8]) == " about (0.6, 0, 0.8)"
    assert axis_text([0.0, 0.0, 0.0]) == ""


def test_things_are_counted_in_plain_english():
    assert [counted(1, "block"), counted(2, "block"), counted(3, "patch", "patches")] == [
        "1 block", "2 blocks", "3 patches",
    ]  # fmt: skip
