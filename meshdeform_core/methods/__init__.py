"""Deformation methods: what a user chooses by name.

==========  ==========================  =====================
name        interfaces moved by         interiors filled by
==========  ==========================  =====================
tfi         TFI on the edge graph       TFI
idw         IDW                         IDW (one step)
idw-tfi     IDW                         TFI in sub-blocks
==========  ==========================  =====================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..errors import MethodError
from .base import Account, Method, PreparedMethod, Problem, Progress, Setting
from .hybrid import Composite
from .idw import IDW
from .tfi import TFI

__all__ = [
    "ALIASES",
    "CATALOGUE",
    "IDW",
    "TFI",
    "Account",
    "Composite",
    "Method",
    "Options",
    "PreparedMethod",
    "Problem",
    "Progress",
    "Setting",
    "make_method",
]

ALIASES = {"tfi": "tfi-tfi", "idw": "idw-idw"}
DEFAULT = "idw-tfi"


@dataclass(frozen=True)
class Options:
    """The ``[method]`` table of a case: the name and the options of every elementary method."""

    name: str = DEFAULT
    idw: IDW = field(default_factory=IDW)
    tfi: TFI = field(default_factory=TFI)


@dataclass(frozen=True)
class Entry:
    """One row of the table of methods: what it is, what to know, whose options it has, how it is made."""

    summary: str
    advice: str
    parts: tuple[type, ...]
    make: Callable[[Options], Method]


CATALOGUE: dict[str, Entry] = {
    "tfi-tfi": Entry(
        "transfinite interpolation everywhere: the fastest, for small motions of simple topologies",
        "Cost N_v. Keeps clustering, loses wall orthogonality, kinks grid lines at block interfaces; crosses cells "
        "when a body rotates by more than about 40 degrees. Has no options.",
        (),
        lambda options: Composite(None, TFI(max_cells=0)),
    ),
    "idw-idw": Entry(
        "inverse distance weighting of every node: the best walls, for large rotations and boundary layers",
        "Cost N_v x N_s. Carries the near-wall grid rigidly with the wall.",
        (IDW,),
        lambda options: Composite(options.idw, None),
    ),
    "idw-tfi": Entry(
        "IDW for block interfaces and virtual sub-block faces, TFI inside: the default, IDW's quality at a fraction of "
        "its cost",
        "Cost N_s x N_v^(2/3) + N_v. max_cells is the price: smaller sub-blocks come closer to IDW.",
        (IDW, TFI),
        lambda options: Composite(options.idw, options.tfi),
    ),
}
"""All methods by their full names."""


def make_method(options: Options) -> Method:
    """The method that ``options.name`` stands for.

    Raises
    ------
    MethodError
        For an unknown name.
    """
    name = ALIASES.get(options.name, options.name)
    if name not in CATALOGUE:
        raise MethodError(f"method {options.name!r} is unknown; known are {', '.join([*ALIASES, *CATALOGUE])}")
    return CATALOGUE[name].make(options)
