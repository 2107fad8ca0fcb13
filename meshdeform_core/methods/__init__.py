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

from dataclasses import dataclass, field

from ..errors import MethodError
from .base import Account, Method, PreparedMethod, Problem, Progress, Setting
from .hybrid import Composite
from .idw import IDW
from .tfi import TFI

__all__ = [
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


def make_method(options: Options) -> Method:
    """The method that ``options.name`` stands for.

    Raises
    ------
    MethodError
        For an unknown name.
    """
    name = ALIASES.get(options.name, options.name)
    methods = {
        "tfi-tfi": Composite(None, TFI(max_cells=0)),
        "idw-idw": Composite(options.idw, None),
        "idw-tfi": Composite(options.idw, options.tfi),
    }
    if name not in methods:
        raise MethodError(f"method {options.name!r} is unknown; known are {', '.join([*ALIASES, *methods])}")
    return methods[name]
