"""Radial basis functions with a linear polynomial (Sen et al. section 2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ...errors import MethodError
from ...grid import IntArray
from ...numerics.exact.basis import BASES
from ..base import Problem
from ..options import MethodOptions, option
from .summation import DIRECT_CENTRES, Summation, summation_tolerance

if TYPE_CHECKING:
    from .prepared_rbf import PreparedRBF

Basis = Literal["tps", "wendland-c0", "wendland-c2", "ctps-c1", "ctps-c2a", "ctps-c2b"]
_GREEDY: Mapping[str, tuple[str, ...]] = {"greedy": ("hybrid",)}
_COMPACT: Mapping[str, tuple[str, ...]] = {"basis": tuple(name for name in BASES if name != "tps")}
_ITERATIVE: Mapping[str, tuple[str, ...]] = {"solver": ("auto", "krylov")}


@dataclass(frozen=True)
class RBF(MethodOptions):
    """Interpolation by radial basis functions: one linear system in N_s, then a sum of cost N_v x N_s.

    Smooth over the whole domain and valid at larger rotations than the other methods, but does not move the near-wall
    grid rigidly with the wall. The system grows as N_s^2 in memory and N_s^3 in time; greedy reduction keeps a subset
    of the centres.

    Attributes
    ----------
    basis : ``tps`` (global), ``wendland-c0``, ``wendland-c2``, ``ctps-c1``, ``ctps-c2a``, ``ctps-c2b`` (Table I)
    radius : support radius of the compact bases (grid length unit), or ``"auto"``: the support of every centre
        covers the whole moving body
    solver : ``direct`` (Cholesky on the null space of the side conditions), ``krylov`` (preconditioned GMRES,
        for any number of centres), or ``"auto"``: direct up to 4000 centres, then krylov
    tolerance : of ``krylov``: ||r|| <= tolerance ||b||; ``"auto"``: 1e-6
    max_iterations : of ``krylov``; not converging is a warning
    greedy : ``none`` or ``hybrid`` (Sen et al.: rounds of single-point updates and exact solutions); compact bases only
    greedy_error : ``first-cell``: errors relative to the height of the first cell at each node; ``absolute``: lengths
    greedy_tolerance : eps_g, largest error at any boundary node, in the unit of ``greedy_error``
    greedy_updates : m, number of single-point updates between exact solutions; 0: the number of sources
    greedy_correct : add the remaining error to the nodes near each wall node, so that walls are matched exactly
    summation : ``exact`` sums at the nodes, or ``fast`` ones with clusters of centres, or ``"auto"``: fast from 2000
        centres and 2e8 pairs of nodes
    summation_tolerance : of fast sums: error of a node's displacement relative to its shortest cell edge, 1e-8 to 0.1
    """

    basis: Basis = option("tps", "no radius to choose; no other basis has a better worst cell on the splitter plate")
    radius: float | Literal["auto"] = option("auto", "every node sees the whole moving body", only_if=_COMPACT)
    solver: Literal["auto", "direct", "krylov"] = option(
        "auto", f"direct up to {DIRECT_CENTRES:,} centres, then krylov"
    )
    tolerance: float | Literal["auto"] = option("auto", "krylov 1e-6", only_if=_ITERATIVE)
    max_iterations: int = option(10000, "well above what a well-posed system needs", only_if=_ITERATIVE)
    greedy: Literal["none", "hybrid"] = option("none", "all centres are kept: exact at every boundary node")
    greedy_error: Literal["first-cell", "absolute"] = option(
        "first-cell", "errors matter most where cells are thin", only_if=_GREEDY
    )
    greedy_tolerance: float = option(0.1, "of the first-cell height: wall cells keep their shape", only_if=_GREEDY)
    greedy_updates: int = option(0, "the number of sources, as in the paper", range="[0, inf)", only_if=_GREEDY)
    greedy_correct: bool = option(True, "walls are matched exactly", only_if=_GREEDY)
    summation: Summation = option("auto", "fast where it pays")
    summation_tolerance: float = summation_tolerance()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.basis == "tps" and self.greedy != "none":
            raise MethodError(
                "method.rbf.greedy does not work with the thin plate spline: its value at distance 0 is 0, so no "
                'centre can correct its own error; choose a compact basis, like wendland-c2, or greedy = "none"'
            )

    def bind(self, problem: Problem, flat: IntArray) -> PreparedRBF:
        """Sources and their images at symmetry planes as centres, and target nodes ``flat``; nothing is solved yet."""
        # Imported here, as its loops take a while to load and other methods need none of them.
        from .prepared_rbf import PreparedRBF

        return PreparedRBF(self, problem, flat)
