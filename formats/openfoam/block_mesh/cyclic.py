"""Cyclic patches of a blockMeshDict as periodic connections, paired by the motion that maps one onto the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, FloatArray, Grid, Periodicity, Shape, Side

from .entries import reading_of, text_of
from .layout import FoamPatch, Layout

_TOLERANCE = 1e-5
"""Largest distance between a corner and its image, relative to the size of the patches."""


@dataclass(frozen=True)
class _Motion:
    rotation: FloatArray
    center: FloatArray
    shift: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        return np.asarray((points - self.center) @ self.rotation.T + self.center + self.shift)

    def periodicity(self) -> Periodicity:
        # Lower case: about the fixed axes x, y, z in turn.
        angles = Rotation.from_matrix(self.rotation).as_euler("xyz", degrees=True)
        return Periodicity(*(tuple(values.tolist()) for values in (self.center, angles, self.shift)))


def cyclic_connections(grid: Grid, layout: Layout) -> Grid:
    """The grid with the connections of its cyclic patches; a note for each pair whose faces do not fit."""
    patches = {patch.name: patch for patch in layout.patches}
    connections, notes = list(grid.connections), list(grid.notes)
    for name, patch in patches.items():
        neighbour = text_of(patch.content, "neighbourPatch") if patch.type == "cyclic" else ""
        if not neighbour:
            continue
        other = patches.get(neighbour)
        if other is None or text_of(other.content, "neighbourPatch") != name:
            raise FormatError(
                f"{layout.path}: cyclic patch {name} has the neighbour {neighbour}, which does not have it"
            )
        if list(patches).index(neighbour) < list(patches).index(name):
            continue
        found = _pairs(grid, patch, other)
        connections += found
        if not found:
            notes.append(f"{layout.path}: no motion maps cyclic patch {name} onto {neighbour}; they are not connected")
    return dataclasses.replace(grid, connections=tuple(connections), notes=tuple(notes))


def _pairs(grid: Grid, one: FoamPatch, two: FoamPatch) -> list[Connection]:
    """A connection for each block side of ``one``; none if any has no partner."""
    if len(one.sides) != len(two.sides):
        return []
    motion = _motion(grid, one, two)
    corners = {key: _corners(grid, *key) for key in (*one.sides, *two.sides)}
    size = max(float(np.ptp(np.concatenate([x for _, x in corners.values()]), axis=0).max()), 0.0)
    found = []
    for number, (block, side) in enumerate(one.sides):
        at, points = corners[block, side]
        for other, donor in two.sides:
            there, candidates = corners[other, donor]
            gaps = np.linalg.norm(motion(points)[:, None] - candidates, axis=2)
            nearest = gaps.argmin(axis=1)
            if gaps.min(axis=1).max() <= _TOLERANCE * size and len(set(nearest.tolist())) == 4:
                name = f"{one.name}-{number + 1}"
                images = [there[n] for n in nearest]
                found.append(_connection(name, (block, side, at), (other, donor, images), motion))
                break
    return found if len(found) == len(one.sides) else []


def _connection(
    name: str,
    own: tuple[int, Side, list[Shape]],
    donor: tuple[int, Side, list[Shape]],
    motion: _Motion,
) -> Connection:
    """The connection from the indices of the corners of a side and of their images, ordered as in :func:`_corners`."""
    (block, side, at), (other, there, images) = own, donor
    transform = [0, 0, 0]
    for axis, corner in zip(side.tangential, (1, 2), strict=True):
        step = np.subtract(images[corner], images[0])
        along = int(np.flatnonzero(step)[0])
        transform[axis] = (along + 1) * (1 if step[along] > 0 else -1)
    # The direction out of one side leads into the other.
    transform[side.axis] = side.into(there)
    i, j, k = transform
    return Connection(name, block, at[0], at[3], other, images[0], images[3], (i, j, k), motion.periodicity())


def _corners(grid: Grid, block: int, side: Side) -> tuple[list[Shape], FloatArray]:
    """Indices and coordinates of the corners of a side: origin, far along the first tangential axis, second, both."""
    shape = grid.shapes[block]
    found = []
    for b in (0, 1):
        for a in (0, 1):
            index = [0, 0, 0]
            index[side.axis] = side.layer(shape)
            for axis, end in zip(side.tangential, (a, b), strict=True):
                index[axis] = (shape[axis] - 1) * end
            found.append((index[0], index[1], index[2]))
    return found, np.array([grid.block(block)[at] for at in found])


def _motion(grid: Grid, one: FoamPatch, two: FoamPatch) -> _Motion:
    """A rotation about the declared axis, else a translation."""
    p, q = (np.concatenate([_corners(grid, *side)[1] for side in patch.sides]) for patch in (one, two))
    if text_of(one.content, "transform") != "rotational" and "rotationAxis" not in one.content.entries:
        return _Motion(np.eye(3), np.zeros(3), q.mean(axis=0) - p.mean(axis=0))
    axis, center = (
        np.array(found.point(key)) if (found := reading_of(one.content, key)).more else np.array(default)
        for key, default in (("rotationAxis", (0.0, 0.0, 1.0)), ("rotationCentre", (0.0, 0.0, 0.0)))
    )
    axis = axis / max(float(np.linalg.norm(axis)), 1e-30)
    a, b = (x.mean(axis=0) - center for x in (p, q))
    a, b = a - (a @ axis) * axis, b - (b @ axis) * axis
    angle = np.arctan2(np.cross(a, b) @ axis, a @ b)
    return _Motion(Rotation.from_rotvec(angle * axis).as_matrix(), center, np.zeros(3))
