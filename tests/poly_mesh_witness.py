"""An independent reader of OpenFOAM meshes, and checks of them in plain numpy."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest


@dataclass
class Mesh:
    points: np.ndarray
    faces: list[list[int]]
    owner: np.ndarray
    neighbour: np.ndarray
    patches: dict[str, dict[str, str]]

    def check(self) -> None:
        """What every mesh of OpenFOAM must fulfil."""
        n_internal, n_cells = len(self.neighbour), int(self.owner.max()) + 1
        assert len(self.owner) == len(self.faces)
        inner = self.owner[:n_internal]
        assert (inner < self.neighbour).all()
        key = inner.astype(np.int64) * n_cells + self.neighbour
        assert (np.diff(key) > 0).all(), "internal faces are not in upper-triangular order, or come twice"
        self._check_patches(n_internal)
        area, center = self.geometry()
        total, size = np.zeros((n_cells, 3)), np.zeros(n_cells)
        for cells, sign in ((self.owner, 1), (self.neighbour, -1)):
            np.add.at(total, cells, sign * area[: len(cells)])
            np.add.at(size, cells, np.linalg.norm(area[: len(cells)], axis=1))
        assert (np.linalg.norm(total, axis=1) < 1e-12 * size).all(), "cells are not closed"
        assert (self.volumes() > 0).all()
        middle = self.middles(center, n_cells)
        outward = np.einsum("ni,ni->n", area, center - middle[self.owner])
        assert (outward > 0).all(), "normals do not point out of the owner"
        used = np.unique(np.concatenate([np.array(face) for face in self.faces]))
        assert len(used) == len(self.points), "some points belong to no face"

    def _check_patches(self, first: int) -> None:
        for entries in self.patches.values():
            assert int(entries["startFace"]) == first
            first += int(entries["nFaces"])
        assert first == len(self.faces)
        for name, entries in self.patches.items():
            if entries["type"] == "cyclic":
                other = self.patches[entries["neighbourPatch"]]
                assert other["neighbourPatch"] == name
                assert other["nFaces"] == entries["nFaces"]

    def patch_faces(self, name: str) -> list[list[int]]:
        start, count = (int(self.patches[name][key]) for key in ("startFace", "nFaces"))
        return self.faces[start : start + count]

    def geometry(self) -> tuple[np.ndarray, np.ndarray]:
        """Area vectors and centres of the faces."""
        area, center = np.empty((len(self.faces), 3)), np.empty((len(self.faces), 3))
        for n, face in enumerate(self.faces):
            x = self.points[face]
            assert len(set(face)) == len(face) >= 3
            center[n] = x.mean(axis=0)
            area[n] = 0.5 * np.cross(x - center[n], np.roll(x, -1, axis=0) - center[n]).sum(axis=0)
        return area, center

    def middles(self, center: np.ndarray, n_cells: int) -> np.ndarray:
        total, count = np.zeros((n_cells, 3)), np.zeros(n_cells)
        for cells in (self.owner, self.neighbour):
            np.add.at(total, cells, center[: len(cells)])
            np.add.at(count, cells, 1)
        return total / count[:, None]

    def volumes(self) -> np.ndarray:
        """By the divergence theorem, faces cut into triangles about their centres."""
        found = np.zeros(int(self.owner.max()) + 1)
        part = np.empty(len(self.faces))
        origin = self.points.mean(axis=0)
        for n, face in enumerate(self.faces):
            x = self.points[face] - origin
            c = x.mean(axis=0)
            part[n] = np.einsum("ni,ni->", np.cross(x, np.roll(x, -1, axis=0)), np.broadcast_to(c, x.shape)) / 6
        np.add.at(found, self.owner, part)
        np.add.at(found, self.neighbour, -part[: len(self.neighbour)])
        return found


def read_mesh(case: Path, points: Path | None = None) -> Mesh:
    """The mesh of a case, with its own points or those of a file."""
    folder = case / "constant" / "polyMesh"
    text = (folder / "boundary").read_text()
    patches = {
        name: dict(re.findall(r"(\w+)\s+([^;]+);", body))
        for name, body in re.findall(r"\n\s+([^\s{]+)\n\s*\{([^}]*)\}", text[text.index("\n(") :])
    }
    return Mesh(
        read_points(points or folder / "points"), _faces(folder / "faces"), _labels(folder / "owner"),
        _labels(folder / "neighbour"), patches,
    )  # fmt: skip


def read_points(path: Path) -> np.ndarray:
    head, count, body = _opened(path)
    if "binary" in head:
        return np.frombuffer(body[: 24 * count]).reshape(-1, 3)
    return np.array(body.replace(b"(", b" ").replace(b")", b" ").split()[: 3 * count], dtype=float).reshape(-1, 3)


def _labels(path: Path) -> np.ndarray:
    head, count, body = _opened(path)
    return np.frombuffer(body[: 4 * count], "<i4") if "binary" in head else np.array(body.split()[:count], dtype=int)


def _faces(path: Path) -> list[list[int]]:
    head, count, body = _opened(path)
    if "binary" not in head:
        return [[int(n) for n in line.split(b"(")[1].rstrip(b")").split()] for line in body.split(b"\n")[1 : count + 1]]
    starts = np.frombuffer(body[: 4 * count], "<i4")
    rest = re.match(rb"\)\s*(\d+)\s*\(", body[4 * count :])
    assert rest is not None
    labels = np.frombuffer(body[4 * count + rest.end() :][: 4 * int(rest[1])], "<i4")
    return [labels[a:b].tolist() for a, b in pairwise(starts.tolist())]


def _opened(path: Path) -> tuple[str, int, bytes]:
    packed = path.with_name(path.name + ".gz")
    content = gzip.decompress(packed.read_bytes()) if packed.exists() else path.read_bytes()
    found = re.search(rb"\}\s*(\d+)\s*\(", content)
    assert found is not None
    return content[: found.start()].decode("latin-1"), int(found[1]), content[found.end() :]


def check_mesh(case: Path) -> str:
    """What OpenFOAM's own program says; skips where it is not installed."""
    if shutil.which("checkMesh") is None:
        pytest.skip("OpenFOAM is not installed")
    head = "FoamFile { version 2.0; format ascii; class dictionary; object x; }\n"
    for name in ("fvSchemes", "fvSolution"):
        (case / "system" / name).write_text(head + "divSchemes {} gradSchemes {} laplacianSchemes {}\n")
    settings = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
    done = subprocess.run(
        ["checkMesh", "-allTopology"], cwd=case, env=settings, capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout
