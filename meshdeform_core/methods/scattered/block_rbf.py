"""RBF as the second step of a hybrid: every block interior from its own faces (Sen et al. section 4)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...boundary import Kind
from ...grid import FloatArray, IntArray, Side
from ...grid.topology import side_nodes
from ...numerics.exact.basis import BASES
from ...parallel import Nodes, for_chunks
from ..base import Account, Problem, Progress, Setting, of_stage
from ..transfinite.tfi import Skeleton, make_skeleton
from .prepared_rbf import Centres, Coefficients, RadialSystem, accurate
from .rbf import RBF

_TARGETS = 1024
"""Nodes moved at a time."""


@dataclass(frozen=True)
class BlockRBF:
    """One small RBF system per block; ``options`` are those of ``[method.rbf]``."""

    options: RBF

    def skeleton(self, problem: Problem) -> Skeleton:
        """Skeleton of block faces except slip planes, whose nodes are not centres."""
        quads, kind = problem.topology.quads, problem.boundary.quad_kind
        sides = [(block, side) for block in range(problem.grid.n_blocks) for side in Side]
        sliding = [key for key in sides if np.isin(kind[quads.of_side(*key)], (Kind.SLIP, Kind.SYMMETRY)).all()]
        return dataclasses.replace(make_skeleton(problem, 0), left_out=frozenset(sliding))

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedBlockRBF:
        """Centres and targets of every block."""
        return PreparedBlockRBF(self.options, problem, skeleton)


@dataclass
class _Block:
    """Centres at the nodes ``known`` of a block, and the other nodes, ``targets``, of this rank."""

    centres: Centres
    known: IntArray
    targets: IntArray
    system: RadialSystem | None = None


class PreparedBlockRBF:
    """Block systems of one undeformed grid, factorised at first use and kept while they fit into memory.

    Each system is solved by one rank; with the coefficients, every rank moves nodes of its own.
    """

    def __init__(self, options: RBF, problem: Problem, skeleton: Skeleton):
        self._options, self._problem, self._skeleton = options, problem, skeleton
        blocks = (self._block(n, skeleton.left_out) for n in range(problem.grid.n_blocks))
        self._blocks = [block for block in blocks if block]
        sizes = [n for n, _ in self.sizes]
        self._keep = 8 * sum(n * n for n in sizes) < problem.memory.size // 2
        self.account = Account()
        self.account.settings |= {
            **options.used("basis", "solver", "tolerance"),
            "largest_block_system": Setting(max(sizes, default=0), "face nodes that are on no slip plane"),
            "factorisations_kept": Setting(self._keep, "all block systems fit half the memory" if self._keep else ""),
        }

    def _block(self, block: int, left_out: frozenset[tuple[int, Side]]) -> _Block | None:
        problem, grid = self._problem, self._problem.grid
        shape = grid.shapes[block]
        sides = [side for side in Side if shape[side.axis] > 1 and (block, side) not in left_out]
        faces = np.unique(np.concatenate([side_nodes(grid, block, side).ravel() for side in sides]))
        if len(faces) == np.prod(shape):
            return None
        # Coincident nodes (seams, collapsed edges) would make the system singular: only one of each is used.
        _, once = np.unique(problem.topology.numbers_of(faces), return_index=True)
        radius: float | None = None
        if self._options.basis != "tps":
            # Every node of a block depends on all of its faces.
            whole = float(np.linalg.norm(np.ptp(grid.points[faces], axis=0)))
            radius = whole if self._options.radius == "auto" else float(self._options.radius)
        centres = Centres.of(grid.points[faces[once]], radius)
        own = grid.offsets[block] + np.array([grid.planes(block).start, grid.planes(block).stop]) * shape[1] * shape[2]
        return _Block(centres, faces[once], np.setdiff1d(np.arange(*own), faces, assume_unique=True))

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Centres and targets of every block's system."""
        return [(len(block.known), len(block.targets)) for block in self._blocks]

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Interior of every block and its slip planes from its other faces, in place in ``displacement``."""
        blocks, report = self._blocks, of_stage(progress, "rbf blocks")
        known = [np.empty(0, dtype=np.int64), *(block.known for block in blocks)]
        values = np.split(displacement[np.concatenate(known)], np.cumsum([len(each) for each in known]))

        def solve() -> list[tuple[FloatArray, FloatArray, Account]]:
            found = []
            for number, (block, told) in enumerate(zip(blocks, values[1:-1], strict=True), 1):
                account = Account()
                found.append((*self._system(block).solve(told, account, None), account))
                if report:
                    report(number, len(blocks))
            return found

        solved = Nodes.of(displacement).ranks.on_first(solve)
        if solved:
            # Report the worst block: one not converged, or the one with the largest residual.
            self.account.notices.clear()
            accounts = [account for _, _, account in solved]
            self.account.include(max(accounts, key=lambda a: (bool(a.notices), np.max(a.settings["residual"].value))))
        points, kind, out = self._problem.grid.nodes.rows, BASES[self._options.basis], Nodes.of(displacement).rows
        tiles = [(n, lo) for n, block in enumerate(blocks) for lo in range(0, len(block.targets), _TARGETS)]

        def work(tile: int, _: int) -> None:
            number, lo = tiles[tile]
            centres, flat = blocks[number].centres, blocks[number].targets[lo : lo + _TARGETS]
            out[flat] = centres.displacement(kind, points[flat], Coefficients(centres.points, *solved[number][:2]))

        for_chunks(work, len(tiles), 1, of_stage(progress, "rbf"))

    def differentiable(self) -> PreparedBlockRBF:
        """The same with accurate solutions, so that :meth:`fill` and :meth:`pull` are transposes of each other."""
        self._problem.grid.nodes.require_whole("a derivative with radial basis functions inside blocks")
        return PreparedBlockRBF(accurate(self._options), self._problem, self._skeleton)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`fill`: pass gradients (n_nodes, 3) from inside blocks on to their faces, in place."""
        for block in self._blocks:
            system = self._system(block)
            given = system.transposed_sums(self._problem.grid.points[block.targets], gradient[block.targets])
            gradient[block.targets] = 0.0
            gradient[block.known] += system.solve_transposed(*given)

    def _system(self, block: _Block) -> RadialSystem:
        system = block.system or RadialSystem(self._options, block.centres, self._problem.memory)
        block.system = system if self._keep else None
        return system
