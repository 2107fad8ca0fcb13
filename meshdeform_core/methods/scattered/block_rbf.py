"""RBF as the second step of a hybrid: every block interior from its own faces (Sen et al. section 4)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...boundary import Kind
from ...grid import FloatArray, IntArray, Side
from ...grid.topology import side_nodes
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...parallel import Shared, alone, current_ranks, for_items, require_whole
from ..base import Account, Problem, Progress, Setting, of_stage
from ..options import used
from ..transfinite.skeleton import Skeleton, make_skeleton
from .centres import Centres
from .radial_system import RadialSystem
from .rbf import RBF


@dataclass(frozen=True)
class BlockRBF:
    """One small RBF system per block; ``options`` are those of ``[method.rbf]``."""

    options: RBF

    def skeleton(self, problem: Problem) -> Skeleton:
        """Skeleton of block faces except slip planes, whose nodes are not centres."""
        require_whole(problem.grid.points, "RBF inside of blocks")
        return dataclasses.replace(make_skeleton(problem, 0), left_out=_slip_sides(problem))

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedBlockRBF:
        """Centres and targets of every block."""
        return PreparedBlockRBF(self.options, problem, skeleton)


def _slip_sides(problem: Problem) -> frozenset[tuple[int, Side]]:
    quads, kind = problem.topology.quads, problem.boundary.quad_kind
    sides = [(block, side) for block in range(problem.grid.n_blocks) for side in Side]
    slides = (Kind.SLIP, Kind.SYMMETRY)
    return frozenset(key for key in sides if np.isin(kind[quads.of_side(*key)], slides).all())


@dataclass
class _Block:
    centres: Centres
    known: IntArray
    targets: IntArray
    system: RadialSystem | None = None


class PreparedBlockRBF:
    """Block systems of one undeformed grid, factorised at first use and kept while they fit into memory."""

    def __init__(self, options: RBF, problem: Problem, skeleton: Skeleton):
        self._options, self._problem = options, problem
        blocks = (self._block(n, skeleton.left_out) for n in range(problem.grid.n_blocks))
        self._blocks = [block for block in blocks if block.targets.size]
        sizes = [len(block.known) for block in self._blocks]
        self._keep = 8 * sum(n * n for n in sizes) < problem.memory.size // 2
        self.account = Account()
        self.account.settings |= {
            **used(options, "basis", "solver", "tolerance"),
            "largest_block_system": Setting(max(sizes, default=0), "face nodes that are on no slip plane"),
            "factorisations_kept": Setting(self._keep, "all block systems fit half the memory" if self._keep else ""),
        }

    def _block(self, block: int, left_out: frozenset[tuple[int, Side]]) -> _Block:
        problem, grid = self._problem, self._problem.grid
        shape = grid.shapes[block]
        sides = [side for side in Side if shape[side.axis] > 1 and (block, side) not in left_out]
        faces = np.unique(np.concatenate([side_nodes(grid, block, side).ravel() for side in sides]))
        # Coincident nodes (seams, collapsed edges) would make the system singular: only one of each is used.
        _, once = np.unique(problem.topology.numbers_of(faces), return_index=True)
        centres = Centres.of(grid.points[faces[once]], self._radius(faces))
        every = np.arange(grid.offsets[block], grid.offsets[block + 1])
        return _Block(centres, faces[once], np.setdiff1d(every, faces, assume_unique=True))

    def _radius(self, faces: IntArray) -> float | None:
        if self._options.basis == "tps":
            return None
        if self._options.radius != "auto":
            return float(self._options.radius)
        # Every node of a block depends on all of its faces.
        return float(np.linalg.norm(np.ptp(self._problem.grid.points[faces], axis=0)))

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Centres and targets of every block's system."""
        return [(len(block.known), len(block.targets)) for block in self._blocks]

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Interior of every block and its slip planes from its other faces, in place in ``displacement``."""
        accounts: list[Account] = []

        def work(number: int) -> None:
            # Each block, including its system, is computed by one rank.
            with alone():
                accounts.append(self._fill(self._blocks[number], displacement))

        def rows(first: int, last: int) -> IntArray:
            return np.concatenate([block.targets for block in self._blocks[first:last]])

        report = of_stage(progress, "rbf blocks")
        for_items(work, len(self._blocks), [Shared(displacement, rows)], report)
        if accounts := current_ranks().gather(accounts):
            # Report the worst block: one not converged, or the one with the largest residual.
            self.account.notices.clear()
            self.account.include(
                max(accounts, key=lambda each: (bool(each.notices), np.max(each.settings["residual"].value)))
            )

    def _fill(self, block: _Block, displacement: FloatArray) -> Account:
        account = Account()
        system = block.system or RadialSystem(self._options.system, block.centres, self._problem.memory)
        coefficients, polynomial = system.solve(displacement[block.known], account, None)
        x = block.centres.normalised(self._problem.grid.points[block.targets])
        moved = radial_sums(BASES[self._options.basis], x, block.centres.points, coefficients)
        displacement[block.targets] = moved + block.centres.polynomial(x)[:, : len(polynomial)] @ polynomial
        block.system = system if self._keep else None
        return account
