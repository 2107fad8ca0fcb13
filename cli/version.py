"""``meshdeform --version``: the version, and with ``-v`` the environment."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("numpy", "scipy", "numba", "h5py", "meshio", "matplotlib", "mpi4py", "pyvista")


def version_lines(verbose: bool) -> list[str]:
    """One line, or with ``verbose`` everything that a bug report should name."""
    lines = [f"meshdeform, version {version('meshdeform')}"]
    if verbose:
        lines += [f"python      {platform.python_version()} on {platform.platform()}"]
        lines += [f"{name:11s} {_version(name)}" for name in _PACKAGES]
        lines += [f"hdf5        {_hdf5()}", f"threads     {_threads()}", f"loops       {_cache()}"]
    return lines


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _hdf5() -> str:
    import h5py

    return str(h5py.version.hdf5_version)


def _threads() -> str:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{cores} (--threads for fewer)"


def _cache() -> str:
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return (
        f"compiled into {folder}"
        if folder
        else "compiled into __pycache__ beside each module (NUMBA_CACHE_DIR changes it)"
    )
