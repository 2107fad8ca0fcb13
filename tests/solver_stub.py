"""What a distributed flow solver gives to a mesh deformation: pieces of zones, each rank some, with their walls."""

from dataclasses import dataclass

import numpy as np

import meshdeform as md

WALL = "BCWall"


@dataclass
class Solver:
    """The pieces of one rank: their degrees of freedom, undeformed coordinates, and wall faces."""

    indices: np.ndarray
    start: np.ndarray
    points: np.ndarray
    conn: np.ndarray
    sizes: np.ndarray
    zones: np.ndarray
    wall_of: list

    @classmethod
    def of(cls, path, rank=0, count=1):
        """Every zone is cut in two along i; the pieces go round the ranks, the last of three or more has none."""
        grid = md.read(path).core
        busy = count - 1 if count > 2 else count
        pieces = []
        for zone, (ni, nj, nk) in enumerate(grid.shapes):
            half = ni // 2
            pieces += [(zone, slice(0, half + 1), (nj, nk)), (zone, slice(half, ni), (nj, nk))]
        return cls._gather(grid, [piece for n, piece in enumerate(pieces) if n % busy == rank])

    @classmethod
    def _gather(cls, grid, pieces):
        numbers, start, points, conn, zones, wall_of = [], [], [], [], [], []
        held = known = 0
        for zone, part, _ in pieces:
            ni, nj, nk = grid.shapes[zone]
            k, j, i = np.meshgrid(np.arange(nk), np.arange(nj), np.arange(ni)[part], indexing="ij")
            numbers.append((grid.offsets[zone] + (k * nj + j) * ni + i).ravel())
            block = grid.block(zone)[part].transpose(2, 1, 0, 3)
            start.append(block.reshape(-1, 3))
            at = held + np.arange(len(start[-1])).reshape(i.shape)
            held += len(start[-1])
            for patch in grid.patches:
                if not patch.bc_type.startswith(WALL):
                    continue
                for window in (w for w in patch.windows if w.block == zone):
                    sheet = _sheet(at, window, part)
                    if min(sheet.shape) < 2:
                        continue
                    node = known + np.arange(sheet.size).reshape(sheet.shape)
                    quads = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1)
                    conn.append(quads.reshape(-1, 4))
                    zones.append(np.full(len(conn[-1]), zone + 1))
                    wall_of.append(sheet.ravel())
                    known += sheet.size
        start = np.concatenate([np.empty((0, 3)), *start])
        wall_of = np.concatenate([np.empty(0, int), *wall_of])
        numbers = np.concatenate([np.empty(0, int), *numbers])
        indices = (3 * numbers[:, None] + np.arange(3)).ravel().astype(np.int32)
        conn = np.concatenate([np.empty((0, 4), int), *conn])
        points = start[wall_of]
        zones = np.concatenate([np.empty(0, int), *zones])
        return cls(indices, start, points, conn.ravel().astype(np.int32), np.full(len(conn), 4), zones, wall_of)

    def set_mesh(self, mesh, zones=False):
        """The calls of a solver's ``setMesh``."""
        mesh.setExternalMeshIndices(self.indices)
        told = (self.zones,) if zones else ()
        mesh.setSurfaceDefinition(self.points, self.conn, self.sizes, *told)


def _sheet(at, window, part):
    """Numbers of the nodes of a wall window that lie in a piece, (rows, columns); ``at`` is ordered k, j, i."""
    ranges = [slice(None)] * 3
    axis, (one, two) = window.side.axis, window.side.tangential
    for tangential, low, high in zip((one, two), window.low, window.high, strict=True):
        ranges[tangential] = slice(low, high + 1)
    assert axis != 0, "walls where a zone begins or ends are not cut"
    low, high = (max(end - part.start, 0) for end in (ranges[0].start, ranges[0].stop))
    ranges[0] = slice(low, min(high, at.shape[2]))
    ranges[axis] = 0 if window.side % 2 == 0 else -1
    return at[ranges[2], ranges[1], ranges[0]]
