"""What is tried until a motion gives a valid grid, in which order, what is kept and what is told: with pretended steps
and repairs, whose numbers of invalid cells each test gives."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from meshdeform_core import stepping
from meshdeform_core.errors import MethodError
from meshdeform_core.methods import Options
from meshdeform_core.quality.validity import Verdict
from meshdeform_core.repair.outcome import Judged, Repair
from meshdeform_core.stepping import State


def name_of(state):
    return "" if state.options.name == "idw-tfi" else f"{state.options.name} "


@pytest.fixture
def impose(monkeypatch):
    """A function that imposes a motion: its final state, and everything tried in order, ``FRACTION`` or, of a repair,
    ``FRACTION EFFORT``, by another method ``METHOD FRACTION``. Its first argument has the numbers of invalid cells
    after these, 5 if not told, one by one if tried again; with smallest relative and scaled Jacobian; or an error."""

    def imposed(told, strategy=stepping.until_valid, contact=None, pinned=None, limit=(), chosen="idw-tfi", **others):
        told, tried = dict(told), []

        def judged(key, repair=None):
            tried.append(key)
            found = told.get(key, 5)
            if isinstance(found, Exception):
                raise found
            if isinstance(found, list):
                told[key], found = found[1:], found[0]
            bad, ratio, scaled = found if isinstance(found, tuple) else (found, 0.5, 0.5)
            cells = SimpleNamespace(extremes={"min_scaled_jacobian": (0, scaled)})
            return Judged(np.zeros((1, 3)), Verdict(np.ones(bad, np.int8), np.array([ratio])), cells, repair)

        def plain_step(state, fraction):
            found = judged(f"{name_of(state)}{fraction:g}")
            now = state.course, state.options, found, state.moved, fraction, state.steps + 1, found, state.repairs
            return stepping._noted(State(*now))

        def repaired(state, effort, polish=False):
            key = f"{name_of(state)}{state.fraction:g} {effort}{' polish' * polish}"
            done = key in others.get("converged", ()), others.get("left_out", {}).get(key)
            found = judged(key, Repair(state.found.count, 1, 1, 0.1, 1, 1.0, done[0], left_out=done[1]))
            return stepping._noted(dataclasses.replace(state, found=found), repair=True)

        pretended = {"plain_step": plain_step, "_repaired": repaired, "find_pinned": lambda *_: pinned}
        for name, function in pretended.items():
            monkeypatch.setattr(stepping, name, function)
        grid = SimpleNamespace(n_nodes=1000, points=np.zeros((1, 3)))
        undeformed = SimpleNamespace(contact=lambda path: contact, grid=grid, topology=SimpleNamespace(n_unique=1))
        course = SimpleNamespace(
            setup=SimpleNamespace(undeformed=undeformed, original=None, boundary=None, grid=grid),
            limit=SimpleNamespace(reached="reached" in limit, exhausted="exhausted" in limit, seconds=3.0),
            **{"path": None, "total": None, "rounded": None, "repairing": True, "polishing": False} | others,
            attempts=[], warnings=[],
        )  # fmt: skip
        return strategy(stepping.beginning(course, Options(chosen))), tried

    return imposed


EIGHT = {f"rbf-tfi {n / 8:g}": 0 for n in range(1, 9)}
FLAT = {"1": (0, 0.001, 0.2), "1 quick": (0, 0.005, 0.1)}
LARGE, AT_ONCE = MethodError("too large"), {"rbf-tfi 1 quick": 0}
CROSSING = {"contact": SimpleNamespace(message="walls meet", fraction=0.5), "pinned": "corners pinned"}
TWO = {"strategy": lambda state: stepping.in_equal_steps(state, 2)}
TWICE = "0.5, 0.5 quick, 0.25, 0.25 quick"
HALVES = f"{TWICE}, 0.125, 0.125 quick, 0.0625, 0.0625 quick"
FIRST = "1, 1 quick, rbf-tfi 0.125, rbf-tfi 0.0625"
EVERYTHING = (
    f"{FIRST}, 1 patient, {HALVES}, rbf-tfi 1, rbf-tfi 1 quick, rbf-tfi 1 patient, "
    f"rbf-tfi {HALVES.replace(', ', ', rbf-tfi ')}"
)
OTHERS = "tfi 1, tfi 1 quick, rbf-tfi 1, rbf-tfi 1 quick"


def failed(attempts, part="nor for any part of it that was tried"):
    kept = f"The grid kept has the whole motion and the fewest invalid cells of {attempts} attempts"
    return f"no valid grid was found for the whole motion, {part}. {kept}"


@pytest.mark.parametrize(
    ("told", "others", "tried", "kept", "warnings"),
    [
        ({"1 quick": 0}, {}, "1, 1 quick", "1/1: 0", []),
        # Steps of the other method, of which the last is repaired; a patient repair; smaller steps, which grow again.
        ({**EIGHT, "rbf-tfi 1 quick": (0, 0.001, 0.5)}, {}, f"1, 1 quick, {', '.join(EIGHT)}, rbf-tfi 1 quick",
         "rbf-tfi 1/8: 0", []),
        ({"1 patient": 0}, {}, f"{FIRST}, 1 patient", "1/1: 0", []),
        ({"0.25 quick": 0, "0.75 quick": 0, "1 quick": [5, 5, 0]}, {},
         f"{FIRST}, 1 patient, {TWICE}, 0.75, 0.75 quick, 1, 1 quick, 1, 1 quick", "1/3: 0", []),
        (AT_ONCE, {}, f"{FIRST}, 1 patient, {HALVES}, rbf-tfi 1, rbf-tfi 1 quick", "rbf-tfi 1/1: 0", []),
        # If nothing succeeds, the fewest invalid cells are kept; 24 attempts are enough.
        ({"1 patient": 4, "rbf-tfi 1 patient": 3}, {}, EVERYTHING, "rbf-tfi 1/1: 3", [failed(24)]),
        ({"1 patient": 3, "rbf-tfi 1 patient": 3}, {}, EVERYTHING, "1/1: 3", [failed(24)]),
        ({"0.0625 quick": 0, "0.125 quick": [5, 0]}, {}, f"{FIRST}, 1 patient, {HALVES}, 0.1875, 0.1875 quick, 0.125, "
         "0.125 quick, 0.25, 0.25 quick, 0.1875, 0.1875 quick, rbf-tfi 1, rbf-tfi 1 quick, rbf-tfi 1 patient",
         "1/1: 5", [failed(24, "only for 12.5% of it")]),
        ({"1 patient": 4, "rbf-tfi 0.125": LARGE, "rbf-tfi 1": LARGE}, {},
         f"1, 1 quick, rbf-tfi 0.125, 1 patient, {HALVES}, rbf-tfi 1", "1/1: 4",
         ["rbf-tfi was not tried: too large", "rbf-tfi was not tried: too large", failed(11)]),
        # Where the boundary alone shows that there is none.
        ({"1 hasty": 0}, CROSSING, "1, 1 hasty", "1/1: 0", []),
        ({"0.45 hasty": 0}, CROSSING, "1, 1 hasty, 0.45, 0.45 hasty", "1/1: 5",
         ["walls meet", "corners pinned", failed(4, "only for 45.0% of it")]),
        ({"0.9": 0}, {"pinned": "here"}, "1, 1 hasty, 0.9, 0.9 hasty", "1/1: 5",
         ["here", failed(4, "only for 90.0% of it")]),
        # A valid grid that is nearly collapsed.
        (FLAT, {"converged": ["1 quick"]}, "1, 1 quick", "1/1: 0", []),
        (FLAT, {}, f"{FIRST}, {OTHERS}", "1/1: 0", []),
        ({f"tfi {step}": cells for step, cells in FLAT.items()}, {"chosen": "tfi"},
         f"{OTHERS[:18]}, {FIRST[12:]}, {OTHERS[20:]}", "tfi 1/1: 0", []),
        ({**FLAT, **EIGHT, "rbf-tfi 1 quick": (0, 0.02, 0.3)}, {}, f"1, 1 quick, {', '.join(EIGHT)}, rbf-tfi 1 quick",
         "rbf-tfi 1/8: 0", []),
        ({**FLAT, **EIGHT, "rbf-tfi 1 quick": (0, 0.02, 0.05), "tfi 1 quick": (0, 0.03, 0.0)}, {},
         f"1, 1 quick, {', '.join(EIGHT)}, rbf-tfi 1 quick, {OTHERS}", "tfi 1/1: 0", []),
        ({**FLAT, "tfi 1 quick": (0, 0.006, 0.0), "rbf-tfi 1 quick": (0, 0.007, 0.0)}, {}, f"{FIRST}, {OTHERS}",
         "rbf-tfi 1/1: 0", []),
        ({}, {"limit": ["reached"]}, "1, 1 quick", "1/1: 5",
         ["the time limit of 3 s was reached ([repair] time_limit)", failed(2)]),
        ({}, {"limit": ["reached", "exhausted"]}, "1, 1 quick", "1/1: 5",
         ["the motion was given up after as much work as is done for 1,000 nodes (docs/validity.md)", failed(2)]),
        # Equal steps, in which a repair that fails is made again with patience; steps that are halved, and stay so.
        ({"0.5 quick": 0}, TWO, "0.5, 0.5 quick, 1, 1 quick, 1 patient", "1/2: 5", []),
        ({}, {**TWO, "left_out": {"0.5 quick": "why"}}, "0.5, 0.5 quick, 1, 1 quick, 1 patient", "1/2: 5", []),
        ({"0.5": 0}, {**TWO, "repairing": False}, "0.5, 1", "1/2: 5", []),
        ({"0.25": 0, "0.375": 0}, {"strategy": stepping.adaptively, "repairing": False},
         "1, 0.5, 0.25, 0.5, 0.375, 0.5, 0.4375, 0.40625, 0.390625, 0.382812, 0.378906", "0.375/2: 0",
         ["only 37.5% of the motion was imposed; a further step of 0.39% makes cells invalid. The grid reached so far "
          "is kept; another method, or planes that slide, may allow more"]),
        # Polishing that reduces the smallest scaled Jacobian of a valid grid is undone.
        ({"1": 3, "1 quick polish": (0, 0.5, 0.4)}, {"polishing": True}, "1, 1 quick polish", "1/1: 0", []),
        ({"1": 0, "1 quick polish": 0}, {"polishing": True}, "1, 1 quick polish", "1/1: 0", []),
        ({"1": 0, "1 quick polish": (0, 0.5, 0.4), "1 quick": 0}, {"polishing": True}, "1, 1 quick polish, 1 quick",
         "1/1: 0", []),
    ],
)  # fmt: skip
def test_attempts(told, others, tried, kept, warnings, impose):
    state, found = impose(told, **others)
    now = f"{name_of(state)}{state.fraction:g}/{state.steps}: {state.found.count}"
    assert (", ".join(found), now, state.course.warnings) == (tried, kept, warnings)


def test_repairs_are_summed_up():
    one, two = Repair(1, 2, 3, 0.4, 5, 6.0, True), Repair(10, 20, 30, 0.3, 50, 60.0, False, left_out="why")
    assert one + two == Repair(11, 22, 30, 0.4, 55, 66.0, False, left_out="why")
    assert two + one == Repair(11, 22, 30, 0.4, 55, 66.0, True)
    assert one.beside(two) == two.beside(one) == Repair(11, 22, 33, 0.4, 55, 66.0, False, left_out="why")


def test_two_repairs_of_a_step_count_its_bad_cells_once(impose):
    for patient, kept, ratio in ((4, 4, 0.2), (5, 5, 0.3), (6, 5, 0.3)):
        told = {"1 quick": (5, 0.3, 0.5), "1 patient": (patient, 0.2, 0.5), "0.5 quick": 0}
        state, _ = impose(told, **TWO)
        assert (state.found.count, state.found.verdict.smallest_ratio) == (kept, pytest.approx(ratio))
        found = [(each.invalid, each.weak, each.newton_steps) for each in (state.repair, state.repairs)]
        assert found == [(5, 1, 2), (10, 2, 3)]
