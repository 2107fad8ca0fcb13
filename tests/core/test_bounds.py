"""No loop reads or writes outside its arrays: what numba does not check unless told to."""

import os
import subprocess
import sys

import pytest

RUNS = """
from cases import body_specs, turning
from grids import frame, frame_2d
from meshdeform_core.deform import Case, deform
from meshdeform_core.methods import Options

body, span = body_specs(turning("20"))
for grid, walls in ((frame_2d(), (body,)), (frame(), (body, span))):
    assert deform(grid, Case(walls, method=Options("tfi"))).valid
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_loops_of_tfi_and_of_the_verdict_stay_within_their_arrays(tmp_path):
    """In a process and a cache of its own: checks are compiled into the loops."""
    own = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-P", "-c", RUNS], env=os.environ | own, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
