"""The examples: a coupling through the interface of preCICE, and a design with its gradients."""

import importlib.util
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import meshdeform as md

FLAP = Path(__file__).parents[2] / "examples" / "flap.py"


def test_implicit_iterations_give_the_same_bytes_for_the_same_displacement():
    example = runpy.run_path(str(FLAP))
    done = list(example["flow"](example["Beam"]()))
    tips = [displacement[:, 1].max() for displacement, _ in done]
    assert len(done) > 12
    assert max(tips) > 0.05
    mesh = md.prepare(md.sample("beam", 40).grid, moving=["beam"], fixed=["outer"])
    for displacement, step in done[::-3]:
        assert step.valid
        again = mesh.deform(displacement).grid.blocks
        assert [block.tobytes() for block in again] == [block.tobytes() for block in step.grid.blocks]


def test_the_same_file_runs_against_the_participant_of_precice(monkeypatch, capsys):
    given = []

    class Participant(runpy.run_path(str(FLAP))["Beam"]):
        def __init__(self, *arguments):
            given.append(arguments)

        def is_coupling_ongoing(self):
            return self.time < 0.099

    monkeypatch.setitem(sys.modules, "precice", SimpleNamespace(Participant=Participant))
    monkeypatch.setattr(sys, "argv", [str(FLAP), "config.xml"])
    runpy.run_path(str(FLAP), run_name="__main__")
    assert given == [("Fluid", "config.xml", 0, 1)]
    assert "iteration 5: tip at 0.0051" in capsys.readouterr().out


OPTIMISE = FLAP.with_name("optimise.py")


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("optimise_example", OPTIMISE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_gradients(example):
    shape = example.Shape(example.prepared(example.section_grid(61, 31)), example.Flow(61, 31))
    random, h = np.random.default_rng(0), 1e-4
    design, change = 0.3 * random.standard_normal(11), random.standard_normal(11)
    found, one, two = (dict(shape.at(design + s * change)) for s in (0.0, h, -h))
    for name, (_, gradient) in found.items():
        expected = (one[name][0] - two[name][0]) / (2 * h)
        assert gradient @ change == pytest.approx(expected, rel=2e-6), name


def test_a_better_section(example, tmp_path):
    shape, start, best = example.optimise(61, 31, most=5)
    first, last = shape.history[0], {name: value for name, (value, _) in shape.at(best).items()}
    assert last["suction"] < 0.85 * first["suction"]
    assert last["lift"] == pytest.approx(example.LIFT, abs=0.01)
    example.picture(shape, start, best, tmp_path / "optimise.png")
    assert (tmp_path / "optimise.png").stat().st_size > 10_000


@pytest.mark.slow
def test_what_the_page_says(example):
    shape, _, best = example.optimise()
    first, last = shape.history[0], {name: value for name, (value, _) in shape.at(best).items()}
    assert round(1.0 - last["suction"] / first["suction"], 2) == 0.29
    assert last["lift"] == pytest.approx(example.LIFT, abs=1e-4)
    assert last["volume"] <= first["volume"] + 1e-6
    assert (1.0 - last["f_skew"]) / (1.0 - first["f_skew"]) == pytest.approx(example.MOST_SKEW, abs=1e-3)
