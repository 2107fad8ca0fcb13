"""An independent reader of OpenFOAM meshes, and checks of them in plain numpy."""

import gzip
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest


@dataclass
class Mesh:
    """``corners`` (n_faces, 4) of the faces, the last one of triangles twice."""

    points: np.ndarray
    corners: np.ndarray
    owner: np.ndarray
    neighbour: np.ndarray
    patches: dict[str, dict[str, str]]

    def check(self) -> None:
        """What every mesh of OpenFOAM must fulfil."""
        n_internal, n_cells = len(self.neighbour), int(self.owner.max()) + 1
        assert len(self.owner) == len(self.corners)
        inner = self.owner[:n_internal]
        assert (inner < self.neighbour).all()
        key = inner.astype(np.int64) * n_cells + self.neighbour
        assert (np.diff(key) > 0).all(), "internal faces are not in upper-triangular order, or come twice"
        first = n_internal
        for name, entries in self.patches.items():
            assert int(entries["startFace"]) == first
            first += int(entries["nFaces"])
            if entries["type"] == "cyclic":
                other = self.patches[entries["neighbourPatch"]]
                assert (other["neighbourPatch"], other["nFaces"]) == (name, entries["nFaces"])
        assert first == len(self.corners)
        kinds = 1 + np.count_nonzero(np.diff(np.sort(self.corners, axis=1), axis=1), axis=1)
        assert (kinds == np.where(self.triangles, 3, 4)).all(), "faces pass through a point twice"
        a, b, c, d = self.points[self.corners].transpose(1, 0, 2)
        area, center = 0.5 * np.cross(c - a, d - b), self.centers()
        total, size = self.of_cells(area), self.of_cells(np.linalg.norm(area, axis=1), both=True)
        assert (np.linalg.norm(total, axis=1) < 1e-12 * size).all(), "cells are not closed"
        assert (self.volumes() > 0).all()
        ones = self.of_cells(np.ones(len(center)), both=True)
        middle = self.of_cells(center, both=True) / ones[:, None]
        assert (np.einsum("ni,ni->n", area, center - middle[self.owner]) > 0).all(), "normals do not leave the owner"
        assert len(np.unique(self.corners)) == len(self.points), "some points belong to no face"

    @property
    def triangles(self) -> np.ndarray:
        return self.corners[:, 2] == self.corners[:, 3]

    def patch_faces(self, name: str) -> np.ndarray:
        start, count = (int(self.patches[name][key]) for key in ("startFace", "nFaces"))
        return self.corners[start : start + count]

    def centers(self) -> np.ndarray:
        x = self.points[self.corners]
        return np.where(self.triangles[:, None], x[:, :3].mean(axis=1), x.mean(axis=1))

    def of_cells(self, values: np.ndarray, both: bool = False) -> np.ndarray:
        """Sums over the faces of each cell; of values that change their sign with the normal unless ``both``."""
        found = np.zeros((int(self.owner.max()) + 1, *values.shape[1:]))
        np.add.at(found, self.owner, values)
        np.add.at(found, self.neighbour, values[: len(self.neighbour)] * (1 if both else -1))
        return found

    def volumes(self) -> np.ndarray:
        """By the divergence theorem, faces cut into triangles about their centres."""
        origin = self.points.mean(axis=0)
        x = self.points[self.corners] - origin
        turns = np.cross(x, np.roll(x, -1, axis=1)).sum(axis=1)
        return self.of_cells(np.einsum("ni,ni->n", turns, self.centers() - origin) / 6)


def read_mesh(case: Path, points: Path | None = None) -> Mesh:
    """The checked mesh of a case, with its own points or those of a file."""
    folder = case / "constant" / "polyMesh"
    text = (folder / "boundary").read_text()
    patches = {
        name: dict(re.findall(r"(\w+)\s+([^;]+);", body))
        for name, body in re.findall(r"\n\s+([^\s{]+)\n\s*\{([^}]*)\}", text[text.index("\n(") :])
    }
    mesh = Mesh(
        read_points(points or folder / "points"), _faces(folder / "faces"), _labels(folder / "owner"),
        _labels(folder / "neighbour"), patches,
    )  # fmt: skip
    mesh.check()
    return mesh


def read_points(path: Path) -> np.ndarray:
    head, count, body = _opened(path)
    if "binary" in head:
        return np.frombuffer(body[: 24 * count]).reshape(-1, 3)
    return np.array(body.replace(b"(", b" ").replace(b")", b" ").split()[: 3 * count], dtype=float).reshape(-1, 3)


def _labels(path: Path) -> np.ndarray:
    head, count, body = _opened(path)
    return np.frombuffer(body[: 4 * count], "<i4") if "binary" in head else np.array(body.split()[:count], dtype=int)


def _faces(path: Path) -> np.ndarray:
    head, count, body = _opened(path)
    if "binary" not in head:
        lines = [line.rstrip(b")").split(b"(")[1].split() for line in body.split(b"\n")[1 : count + 1]]
        return np.array([(*line, line[-1])[:4] for line in lines], dtype=int)
    starts = np.frombuffer(body[: 4 * count], "<i4")
    rest = re.match(rb"\)\s*(\d+)\s*\(", body[4 * count :])
    assert rest is not None
    labels = np.frombuffer(body[4 * count + rest.end() :][: 4 * int(rest[1])], "<i4")
    return labels[np.minimum(starts[:-1, None] + np.arange(4), starts[1:, None] - 1)]


def _opened(path: Path) -> tuple[str, int, bytes]:
    packed = path.with_name(path.name + ".gz")
    content = gzip.decompress(packed.read_bytes()) if packed.exists() else path.read_bytes()
    found = re.search(rb"\}\s*(?://[^\n]*\s*)*(\d+)\s*\(", content)
    assert found is not None
    return content[: found.start()].decode("latin-1"), int(found[1]), content[found.end() :]


def run_foam(program: str, case: Path, *arguments: str) -> str:
    """What a program of OpenFOAM says about a case; skips where it is not installed."""
    if shutil.which(program) is None:
        pytest.skip("OpenFOAM is not installed")
    settings = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
    return subprocess.run(
        [program, *arguments], cwd=case, env=settings, capture_output=True, text=True, timeout=300, check=True
    ).stdout


def write_system(case: Path, **dictionaries: str) -> None:
    """Dictionaries of a case, all of which OpenFOAM's programs read before they begin."""
    (case / "system").mkdir(exist_ok=True)
    control = "application x; startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 1; "
    control += "writeControl timeStep; writeInterval 1; writePrecision 17; writeFormat ascii;"
    empty = "divSchemes {} gradSchemes {} laplacianSchemes {}"
    for name, text in ({"controlDict": control, "fvSchemes": empty, "fvSolution": empty} | dictionaries).items():
        head = f"FoamFile {{ version 2.0; format ascii; class dictionary; object {name}; }}\n"
        (case / "system" / name).write_text(text if text.startswith("FoamFile") else head + text)


def check_mesh(case: Path) -> str:
    """What OpenFOAM's own program says of a mesh."""
    write_system(case, controlDict=(case / "system/controlDict").read_text())
    return run_foam("checkMesh", case, "-allTopology")
