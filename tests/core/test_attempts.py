"""Which of several grids is kept."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame_2d

from meshdeform_core.deform import Case, deform
from meshdeform_core.methods import Options
from meshdeform_core.repair import RepairOptions
from meshdeform_core.stepping import attempts
from meshdeform_core.stepping.steps import Coordinates, plain_step


@pytest.mark.parametrize(
    ("ratios", "kept", "tried"),
    [
        ({"idw": 0.002, "tfi": 0.005, "rbf-tfi": 0.004}, "tfi", 3),
        ({"idw": 0.002, "tfi": 0.003, "rbf-tfi": 0.004}, "rbf-tfi", 3),
        ({"idw": 0.006, "tfi": 0.005, "rbf-tfi": 0.004}, "idw", 3),
        ({"idw": 0.002, "tfi": -0.5, "rbf-tfi": 0.001}, "idw", 3),
        ({"idw": 0.02, "tfi": 0.5, "rbf-tfi": 0.4}, "idw", 1),
    ],
)
def test_of_nearly_collapsed_grids_the_best_one_is_kept(ratios, kept, tried, monkeypatch):
    """Smallest relative Jacobians that the methods reach are pretended; one that is negative is an invalid grid."""
    seen = []

    def repaired(trial, ways=None):
        ratio = ratios[trial.state.options.name]
        seen.append(trial.state.options.name)
        verdict = dataclasses.replace(
            trial.plain.verdict,
            ratio=np.full_like(trial.plain.verdict.ratio, ratio),
            failed=np.full_like(trial.plain.verdict.failed, ratio < 0),
        )
        return dataclasses.replace(trial, found=Coordinates(trial.plain.points, verdict))

    monkeypatch.setattr(attempts, "_without_repairs", lambda course: None)
    monkeypatch.setattr(attempts, "repaired", repaired)
    monkeypatch.setattr(attempts, "step", lambda state, fraction, ways=None: repaired(plain_step(state, fraction)))
    grid, specs = frame_2d(), tuple(body_specs(turning(8.0))[:1])
    result = deform(grid, Case(specs, {}, Options("idw")))
    alone = deform(grid, Case(specs, {}, Options(kept), repair=RepairOptions("off")))
    np.testing.assert_array_equal(result.grid.points, alone.grid.points)
    assert len(seen) == tried
