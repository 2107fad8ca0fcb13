"""The machine and its limits, measured in the same process as everything else."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
from pathlib import Path

import numba
import numpy as np
from tables import MarkdownTable, best

from meshdeform_core.parallel import for_chunks, thread_count

_NODES = 4_000_000
_LENGTH = 2048
_ROUNDS = 1000
_TERMS = 64
PAIR_OPERATIONS = 18
"""Additions, multiplications and multiply-adds of an IDW pair with seven values, beside one root and one division."""


def description() -> MarkdownTable:
    """Processor, memory and versions."""
    versions = {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "numba", "h5py")}
    rows = [
        {"what": "processor", "value": _processor()},
        {"what": "cores used", "value": thread_count()},
        {"what": "memory", "value": f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.0f} GiB"},
        {"what": "system", "value": f"{platform.system()} {platform.release()}, Python {platform.python_version()}"},
        {"what": "libraries", "value": ", ".join(f"{name} {number}" for name, number in versions.items())},
    ]
    return MarkdownTable("Machine", rows)


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def limits() -> MarkdownTable:
    """Copy bandwidth, and arithmetic per core as far as the IDW loop needs it."""
    rows = [{"limit": f"copy, {n} thread{'s' * (n > 1)}", "value": copy_bandwidth(n), "unit": "GB/s read and written"}
            for n in sorted({1, thread_count()})]  # fmt: skip
    fused, roots = multiply_adds(), roots_and_divisions()
    return MarkdownTable(
        "Limits of the machine",
        [
            *rows,
            {"limit": "multiply-add", "value": fused / 1e9, "unit": "1e9 double precision operations/s/core"},
            {"limit": "square root and division", "value": roots / 1e9, "unit": "1e9 pairs of them/s/core"},
        ],
    )


def copy_bandwidth(threads: int, nodes: int = _NODES) -> float:
    """GB/s of copying a coordinate array (n, 3), bytes read plus bytes written."""
    return 2e-9 * 24 * nodes / copy_seconds(nodes, threads)


def copy_seconds(nodes: int, threads: int) -> float:
    """Time of copying coordinates (nodes, 3) with numpy into memory that is already in use."""
    source, target = np.ones((nodes, 3)), np.zeros((nodes, 3))

    def work(lo: int, hi: int) -> None:
        np.copyto(target[lo:hi], source[lo:hi])

    return best(lambda: for_chunks(work, nodes, -(-nodes // threads)), 7)


@numba.njit(cache=True, fastmath=True)
def _polynomials(x, out):
    # Eight chains at a time: the next multiply-add of one has to wait for the last.
    for _ in range(_ROUNDS):
        for i in range(x.size):
            v = x[i]
            a, b, c, d = 1.0, 2.0, 3.0, 4.0
            e, f, g, h = 5.0, 6.0, 7.0, 8.0
            for _ in range(_TERMS // 8):
                a, b, c, d = a * v + 0.1, b * v + 0.2, c * v + 0.3, d * v + 0.4
                e, f, g, h = e * v + 0.5, f * v + 0.6, g * v + 0.7, h * v + 0.8
            out[i] += (a * b + c * d) + (e * f + g * h)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _inverse_roots(x):
    total = 0.0
    for n in range(_ROUNDS):
        shift = 1.0 + n
        for i in range(x.size):
            total += 1.0 / math.sqrt(x[i] + shift)
    return total


def multiply_adds() -> float:
    """Multiply-adds per second on one core: polynomials of numbers in the first-level cache."""
    x, out = np.linspace(0.1, 0.5, _LENGTH), np.zeros(_LENGTH)
    _polynomials(x, out)
    return _ROUNDS * _LENGTH * _TERMS / best(lambda: _polynomials(x, out), 5)


def roots_and_divisions() -> float:
    """Square roots, each with one division, per second on one core."""
    x = np.linspace(0.1, 0.5, _LENGTH)
    _inverse_roots(x)
    return _ROUNDS * _LENGTH / best(lambda: _inverse_roots(x), 5)
