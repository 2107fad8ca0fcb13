"""Series that are begun, stopped, continued, damaged and begun anew in any order: what is there is always right."""

import errno
import json
import os
import shutil
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from grids import CASE, frame
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from fuzz.bench import called
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.files import invalid_path

pytestmark = pytest.mark.slow

LEVELS = 4
MOVING = CASE.replace('angle = "turn"', 'angle = "turn * t"')
# Folds cells at the third level only: t = 2 turns by 160 degrees, t = 3 back by 360.
FOLDING = CASE.replace('angle = "turn"', 'angle = "where(t == 2, 160, turn * t)"')


class Series(RuleBasedStateMachine):
    """The folder of one series, and what its levels must be."""

    suffix = ".xyz"

    @initialize(folding=st.booleans())
    def begin(self, folding):
        self.home, self.folder = os.getcwd(), Path(tempfile.mkdtemp())
        os.chdir(self.folder)
        Path("case.toml").write_text(FOLDING if folding else MOVING)
        write_grid(frame(2, 2), "grid.xyz")
        self.folding = folding
        command = ["series", "grid.xyz", "-c", "case.toml", "-m", "tfi", "--times", "0:3:1"]
        self.command = [*command, "--repair", "off", "-q"]
        self.command += ["--suffix", self.suffix]
        code, told = called(*self.command, "-o", "whole")
        assert code == (3 if self.invalid_levels("whole") else 0), told
        self.expected = [level.points for level in map(read_grid, self.files("whole"))]
        self.names = {path.name for path in Path("whole").iterdir() if path.is_file()}
        self.final = code

    def teardown(self):
        os.chdir(self.home)
        shutil.rmtree(self.folder)

    @staticmethod
    def records(folder: str) -> list[dict]:
        state = Path(folder, "series.json")
        return json.loads(state.read_text())["levels"] if state.exists() else []

    def invalid_levels(self, folder: str) -> list[int]:
        return [record["number"] for record in self.records(folder) if not record["valid"]]

    def files(self, folder: str) -> list[Path]:
        return [Path(folder, record["file"]) for record in self.records(folder)]

    def run(self, *more: str) -> int:
        code, told = called(*self.command, "-o", "out", *more)
        assert code in (2, self.final), told
        assert told.count("meshdeform: error: ") == (code == 2), told
        return code

    @rule()
    def resume(self):
        assert self.run("--resume") == self.final
        assert len(self.records("out")) == LEVELS

    @rule()
    def anew(self):
        assert self.run("--force") == self.final

    @rule(at=st.integers(1, 12), force=st.booleans(), kind=st.sampled_from([errno.ENOSPC, errno.EIO, errno.EACCES]))
    def fails(self, at, force, kind):
        """The system refuses the renaming that would complete a file."""
        left, rename = [at], os.replace

        def refused(*paths):
            left[0] -= 1
            if left[0] <= 0:
                raise OSError(kind, os.strerror(kind))
            rename(*paths)

        with mock.patch("os.replace", refused):
            self.run("--force" if force else "--resume")

    @precondition(lambda self: Path("out/series.json").exists())
    @rule(data=st.data())
    def loses_a_file(self, data):
        present = sorted(path for path in Path("out").iterdir() if path.is_file() and path.suffix == self.suffix)
        if present:
            data.draw(st.sampled_from(present)).unlink()

    @invariant()
    def what_is_there_is_right(self):
        if not hasattr(self, "expected") or not Path("out").is_dir():
            return
        for number, record in enumerate(self.records("out")):
            path = Path("out", record["file"])
            assert (path == invalid_path(path.with_name(path.name.replace(".invalid", "")))) != record["valid"]
            if path.exists():
                np.testing.assert_array_equal(read_grid(path).points, self.expected[number])

    @invariant()
    def a_complete_series_is_like_one_that_was_never_stopped(self):
        state = Path("out/series.json")
        if not hasattr(self, "expected") or not state.exists() or not json.loads(state.read_text())["complete"]:
            return
        assert {path.name for path in Path("out").iterdir() if path.is_file()} <= self.names


@pytest.mark.parametrize("suffix", [".xyz", ".vtm"])
def test_series_in_all_states(suffix, monkeypatch):
    monkeypatch.setattr(Series, "suffix", suffix)
    run_state_machine_as_test(
        Series,
        settings=settings(
            max_examples=4,
            stateful_step_count=6,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )
