"""Deformation methods: what a user chooses by name, two steps for block interfaces and for block interiors each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..boundary.constraints import find_layer
from ..errors import MethodError, suggestion
from .base import Account, PreparedMethod, Problem, Progress
from .composite import Composite, PreparedLayer
from .gaps import PreparedInGaps
from .options import MethodOptions, declared
from .scattered.idw import IDW
from .scattered.rbf import RBF
from .transfinite.tfi import TFI

__all__ = [
    "ALIASES",
    "CATALOGUE",
    "IDW",
    "PARTS",
    "RBF",
    "TFI",
    "Account",
    "MethodOptions",
    "Options",
    "PreparedMethod",
    "Problem",
    "Progress",
    "declared",
    "entry_of",
    "make_method",
    "prepare_method",
]

ALIASES = {"tfi": "tfi-tfi", "rbf": "rbf-rbf", "idw": "idw-idw"}
DEFAULT = "idw-tfi"
PARTS = {"idw": IDW, "rbf": RBF, "tfi": TFI}
"""Tables of options in a case file, ``[method.idw]`` and so on; fields of :class:`Options`."""


@dataclass(frozen=True)
class Options:
    """The ``[method]`` table of a case: the name and the options of every elementary method."""

    name: str = DEFAULT
    idw: IDW = field(default_factory=IDW)
    rbf: RBF = field(default_factory=RBF)
    tfi: TFI = field(default_factory=TFI)

    def __post_init__(self) -> None:
        used = entry_of(self.name).parts
        for part in (getattr(self, name) for name in PARTS):
            if not isinstance(part, used) and part != type(part)():
                known = " and ".join(kind.__name__ for kind in used) or "no options"
                raise MethodError(
                    f"method {self.name!r} does not use the options {part}; it takes {known}. Leave them out, or "
                    f"choose another method"
                )

    @classmethod
    def relevant(cls, name: str, **parts: MethodOptions) -> Options:
        """Options with only those ``parts`` that the method uses, as one case file may serve several methods."""
        used = entry_of(name).parts
        return cls(name, **{key: part for key, part in parts.items() if isinstance(part, used)})  # type: ignore[arg-type]


@dataclass(frozen=True)
class MethodEntry:
    """One row of the table of methods: summary, advice, options, factory."""

    summary: str
    advice: str
    parts: tuple[type, ...]
    make: Callable[[Options], Composite]


def _default(options: Options) -> Composite:
    # With the paper's kinds of rotation, or blocks that are never cut, methods are exactly as published.
    published = options.idw.rotation != "lie" or options.tfi.max_cells == 0
    return Composite(options.idw, options.tfi, None if published else PreparedInGaps)


def _idw_rbf(options: Options) -> Composite:
    from .scattered.block_rbf import BlockRBF

    return Composite(options.idw, BlockRBF(options.rbf))


CATALOGUE: dict[str, MethodEntry] = {
    "tfi-tfi": MethodEntry(
        "transfinite interpolation everywhere: the fastest, for small motions of simple topologies",
        "Cost N_v. Keeps clustering, loses wall orthogonality, kinks grid lines at block interfaces; crosses cells "
        "when a body rotates by more than about 40 degrees. Has no options.",
        (),
        lambda options: Composite(None, TFI(max_cells=0)),
    ),
    "rbf-rbf": MethodEntry(
        "radial basis functions for every node: smooth, valid at the largest rotations",
        "Cost N_s^3 + N_v x N_s. Does not carry the near-wall grid rigidly with the wall.",
        (RBF,),
        lambda options: Composite(options.rbf, None),
    ),
    "idw-idw": MethodEntry(
        "inverse distance weighting of every node: the best walls, for large rotations and boundary layers",
        "Cost N_v x N_s. Carries the near-wall grid rigidly with the wall.",
        (IDW,),
        lambda options: Composite(options.idw, None),
    ),
    "rbf-tfi": MethodEntry(
        "RBF for block interfaces and virtual sub-block faces, TFI inside",
        "Cost N_s^3 + N_s x N_v^(2/3) + N_v: saves the sum over all nodes, but not the system.",
        (RBF, TFI),
        lambda options: Composite(options.rbf, options.tfi),
    ),
    "idw-rbf": MethodEntry(
        "IDW for block interfaces, RBF inside every block",
        "One system per block in its face nodes. Smooth inside blocks, kinked at their interfaces.",
        (IDW, RBF),
        _idw_rbf,
    ),
    "idw-tfi": MethodEntry(
        "IDW for block interfaces and virtual sub-block faces, TFI inside: the default, IDW's quality at a fraction of "
        "its cost",
        "Cost N_s x N_v^(2/3) + N_v. max_cells trades cost for quality: smaller sub-blocks are closer to IDW.",
        (IDW, TFI),
        _default,
    ),
}
"""All methods by their full names."""


def entry_of(name: str) -> MethodEntry:
    """The catalogue row of a method name or its short form; an unknown one is an error that lists the known ones."""
    full = ALIASES.get(name, name)
    if full not in CATALOGUE:
        known = [*ALIASES, *CATALOGUE]
        raise MethodError(f"method {name!r} is unknown; known are {', '.join(known)}{suggestion(name, known)}")
    return CATALOGUE[full]


def make_method(options: Options) -> Composite:
    """The method that ``options`` describe."""
    return entry_of(options.name).make(options)


def prepare_method(options: Options, problem: Problem) -> PreparedMethod:
    """The method that ``options`` describe, bound to a grid."""
    method = make_method(options)
    layer = find_layer(problem.grid, problem.topology, problem.boundary.kind, problem.boundary.known)
    return method.prepare(problem) if layer is None else PreparedLayer(method, problem, layer)
