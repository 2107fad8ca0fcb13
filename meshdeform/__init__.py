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
    from meshdeform_core.errors import CaseError as CaseError
    from meshdeform_core.errors import FormatError as FormatError
    from meshdeform_core.errors import GridError as GridError
    from meshdeform_core.errors import MeshDeformError as MeshDeformError
    from meshdeform_core.errors import MethodError as MethodError
    from meshdeform_core.errors import MotionError as MotionError
    from meshdeform_core.methods import IDW as IDW
    from meshdeform_core.methods import RBF as RBF
    from meshdeform_core.methods import TFI as TFI

    from .choice import Hybrid as Hybrid
    from .grids.files import read as read
    from .grids.files import write as write
    from .grids.grid import Grid as Grid
    from .prepared.mesh import Mesh as Mesh
    from .prepared.preparation import prepare as prepare
    from .prepared.step import Step as Step
    from .tasks import Difference as Difference
    from .tasks import Sample as Sample
    from .tasks import compare as compare
    from .tasks import deform as deform
    from .tasks import quality as quality
    from .tasks import sample as sample

    __version__: str

_ERRORS, _METHODS = "meshdeform_core.errors", "meshdeform_core.methods"
_HOME = {
    "read": ".grids.files",
    "write": ".grids.files",
    "Grid": ".grids.grid",
    "prepare": ".prepared.preparation",
    "Mesh": ".prepared.mesh",
    "Step": ".prepared.step",
    "deform": ".tasks",
    "quality": ".tasks",
    "compare": ".tasks",
    "Difference": ".tasks",
    "sample": ".tasks",
    "Sample": ".tasks",
    "TFI": _METHODS,
    "RBF": _METHODS,
    "IDW": _METHODS,
    "Hybrid": ".choice",
    "MeshDeformError": _ERRORS,
    "GridError": _ERRORS,
    "FormatError": _ERRORS,
    "CaseError": _ERRORS,
    "MotionError": _ERRORS,
    "MethodError": _ERRORS,
}

__all__ = [*_HOME, "__version__"]

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
