"""The processor that loops are compiled for: this machine's, or a common denominator of several machines."""

from __future__ import annotations

import os
import sys

from ..errors import CaseError

VARIABLE = "MESHDEFORM_CPU"

# The levels of the x86-64 psABI, with a feature that tells whether a processor has reached each of them.
LEVELS = {"x86-64": "sse2", "x86-64-v2": "sse4.2", "x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}


def choose_processor() -> None:
    """Let numba compile for the level of processors that the environment variable MESHDEFORM_CPU names, if any.

    Machines that share a folder of compiled loops then find each other's. Without the variable, loops have the key of
    the machine's own processor, so that no machine runs loops made for another one.

    Raises
    ------
    CaseError
        If the name is unknown, this processor is below the level, or numba has been imported for another one.
    """
    level = os.environ.get(VARIABLE)
    if not level:
        return
    from llvmlite.binding import get_host_cpu_features

    if level not in LEVELS:
        raise CaseError(f"{VARIABLE} (or --cpu) is {level!r}; expected one of {', '.join(LEVELS)}")
    if not get_host_cpu_features().get(LEVELS[level]):
        raise CaseError(f"{VARIABLE} is {level!r}, but this processor lacks {LEVELS[level]}; use a lower level")
    if "numba" in sys.modules and os.environ.get("NUMBA_CPU_NAME") != level:
        raise CaseError(f"{VARIABLE} is {level!r}, but numba was imported before meshdeform: import meshdeform first")
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = level, ""
