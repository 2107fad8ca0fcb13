"""``examples/flap.py``: a coupling by implicit iterations through preCICE's interface."""

import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import meshdeform as md

FILE = Path(__file__).parents[2] / "examples" / "flap.py"


def test_implicit_iterations_give_the_same_bytes_for_the_same_displacement():
    example = runpy.run_path(str(FILE))
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

    class Participant(runpy.run_path(str(FILE))["Beam"]):
        def __init__(self, *arguments):
            given.append(arguments)

        def is_coupling_ongoing(self):
            return self.time < 0.099

    monkeypatch.setitem(sys.modules, "precice", SimpleNamespace(Participant=Participant))
    monkeypatch.setattr(sys, "argv", [str(FILE), "config.xml"])
    runpy.run_path(str(FILE), run_name="__main__")
    assert given == [("Fluid", "config.xml", 0, 1)]
    assert "iteration 5: tip at 0.0051" in capsys.readouterr().out
