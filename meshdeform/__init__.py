"""Deform block-structured grids and judge the result.

One function per task: :func:`read` and :func:`write` grids, :func:`prepare` a grid and a method for many displacements,
:func:`deform` once according to a case file, judge with :func:`quality`, :func:`compare` two grids, make a
:func:`sample` case. Grids in memory are :class:`Grid` objects; methods are :class:`TFI`, :class:`RBF`, :class:`IDW` and
:class:`Hybrid`, or their names.

    import meshdeform as md

    mesh = md.prepare("wing.cgns", moving=["wing"], symmetry=["sym"])
    step = mesh.deform(displacement)  # (n_moving, 3), one row per node of mesh.points
    if step.valid:
        md.write(step.grid, "bent.cgns")

Everything else is imported when it is first used; ``import meshdeform`` itself loads no numpy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from meshdeform_core.errors import CaseError, FormatError, GridError, MeshDeformError, MethodError, MotionError
    from meshdeform_core.methods import IDW, RBF, TFI

    from .grid import Grid, read, write
    from .mesh import Mesh
    from .step import Step
    from .tasks import Difference, Hybrid, Sample, compare, deform, prepare, quality, sample

    __version__: str

__all__ = [
    "IDW", "RBF", "TFI", "CaseError", "Difference", "FormatError", "Grid", "GridError", "Hybrid", "Mesh",
    "MeshDeformError", "MethodError", "MotionError", "Sample", "Step", "__version__", "compare", "deform", "prepare",
    "quality", "read", "sample", "write",
]  # fmt: skip

_NAMES = {
    ".grid": ("Grid", "read", "write"),
    ".mesh": ("Mesh",),
    ".step": ("Step",),
    ".tasks": ("Difference", "Hybrid", "Sample", "compare", "deform", "prepare", "quality", "sample"),
    "meshdeform_core.methods": ("TFI", "RBF", "IDW"),
    "meshdeform_core.errors": (
        "MeshDeformError", "GridError", "FormatError", "CaseError", "MotionError", "MethodError",
    ),
}  # fmt: skip
_HOME = {name: module for module, names in _NAMES.items() for name in names}

if not TYPE_CHECKING:

    def __getattr__(name):
        if name == "__version__":
            from importlib.metadata import version

            value = version("meshdeform")
        elif name in _HOME:
            value = getattr(importlib.import_module(_HOME[name], __package__), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}; available: {', '.join(_HOME)}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
