"""``meshdeform --version``: the version, and with ``-v`` the environment."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("numpy", "scipy", "numba", "h5py", "meshio", "matplotlib", "mpi4py", "pyvista")


def version_lines(verbose: bool) -> list[str]:
    """One line, or with ``verbose`` everything that a bug report should name."""
    facts = {}
    if verbose:
        import h5py

        facts["python"] = f"{platform.python_version()} on {platform.platform()}"
        for name in _PACKAGES:
            try:
                facts[name] = version(name)
            except PackageNotFoundError:
                facts[name] = "not installed"
        facts["hdf5"] = h5py.version.hdf5_version
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        facts["threads"] = f"{cores} (--threads for fewer)"
        beside = "__pycache__ beside each module (NUMBA_CACHE_DIR changes it)"
        facts["loops"] = f"compiled into {os.environ.get('NUMBA_CACHE_DIR') or beside}"
    return [f"meshdeform, version {version('meshdeform')}", *(f"{name:11s} {fact}" for name, fact in facts.items())]
