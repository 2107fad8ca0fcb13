"""The options of IDWarp's meshes: honoured, mapped with a note, or refused."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.methods import IDW, RBF, TFI
from meshdeform_formats.case.forms import Form, ThreeNumbers, about, filled, plain

from ..tasks import Hybrid, Method, options_of

_PART = 1e-3
"""Tolerance of fast sums (relative to the cell) as a fraction of ``errTol`` (relative to the displacement).

With it, finite differences with steps of 1e-6 agree with the derivative to 1e-7 (sample wing, 90,650 nodes), in 1.5
times the time that ``errTol`` itself would take.
"""
_WITH_IDW = {"idw": None, "idw-tfi": TFI, "idw-rbf": RBF}
_Positive = Annotated[float, Meta(gt=0.0), about("a positive number")]
_Switch = Annotated[bool, about("True or False")]
_Families = Annotated[list[str] | None, about("a list of family names")]

NOTES = {
    "errTol": "fast sums err by at most a thousandth of it, relative to the shortest cell edge at a node",
    "evalMode": "'fast' uses fast sums where they pay, exact ones for smaller grids",
    "useRotations": "rotations are averaged as twists (rotation = 'lie'), independent of the frame",
    "zeroCornerRotations": "rotations near sharp edges are averaged with those around them instead of being zeroed",
    "cornerAngle": "edges are sharp from about 50 degrees on",
    "restartFile": "nothing is read or written: preparing takes less time than reading it would",
    "bucketSize": "has no effect: clusters are chosen by the tolerance",
}
"""What options mean here where that differs from IDWarp."""


class Options(Form):
    """IDWarp's options with its names, and two of ours, ``method`` and ``repair``."""

    gridFile: Annotated[str, about("the name of a grid file")]
    fileType: Annotated[
        Literal["CGNS", "PLOT3D"],
        about("one of CGNS, PLOT3D; unstructured meshes, as those of OpenFOAM, are not read"),
    ] = "CGNS"
    specifiedSurfaces: _Families = None
    symmetrySurfaces: _Families = None
    symmetryPlanes: Annotated[
        list[tuple[ThreeNumbers, ThreeNumbers]] | None, about("[[[x, y, z], [nx, ny, nz]], ...], or [] for none")
    ] = None
    aExp: _Positive = 3.0
    bExp: _Positive = 5.0
    LdefFact: _Positive = 1.0
    alpha: _Positive = 0.25
    errTol: _Positive = 0.0005
    evalMode: Annotated[Literal["fast", "exact"], about("one of fast, exact")] = "fast"
    symmTol: _Positive = 1e-6
    useRotations: _Switch = True
    zeroCornerRotations: _Switch = True
    cornerAngle: _Positive = 30.0
    restartFile: Any = None
    bucketSize: Any = 8
    method: Any = "idw"
    repair: Annotated[Literal["off", "auto", "polish"], about("one of off, auto, polish")] = "off"

    @classmethod
    def of(cls, given: Mapping[str, Any] | None) -> Options:
        """The options given; unknown ones, those given twice and wrong values are refused."""
        if not isinstance(given, Mapping):
            raise CaseError(f"options = {given!r}; expected a mapping with 'gridFile' and others")
        values: dict[str, Any] = {"gridFile": None}
        spelled: dict[str, str] = {}
        for name, value in given.items():
            known = known_name(name)
            if (other := spelled.setdefault(known, name)) != name:
                raise CaseError(f"found both {other!r} and {name!r}; expected an option once, in any case")
            written = str.upper if known == "fileType" else str.lower if known in ("evalMode", "repair") else str
            values[known] = written(value) if isinstance(value, str) else plain(value)
        found = filled(cls, values)
        if not all(any(normal) for _, normal in found.symmetryPlanes or ()):
            raise CaseError(f"symmetryPlanes = {values['symmetryPlanes']}; expected normals that are not zero")
        if found.fileType == "PLOT3D" and found.symmetryPlanes is None:
            raise CaseError(
                "symmetryPlanes is missing: a Plot3D file holds no boundary conditions; expected a list of planes, "
                "[[point, normal], ...], or [] for none"
            )
        if not found.has_idw:
            # Names and objects alike: unknown ones are refused here, not at the first warp.
            options_of(found.method)
        if found.cornerAngle != 30.0:
            warnings.warn(f"cornerAngle = {found.cornerAngle:g} has no effect: {NOTES['cornerAngle']}", stacklevel=3)
        return found

    def set(self, name: str, value: Any) -> None:
        """Change an option."""
        known = known_name(name)
        setattr(self, known, getattr(Options.of({**msgspec.structs.asdict(self), known: value}), known))

    @property
    def has_idw(self) -> bool:
        """Whether the method is the name of one that takes IDWarp's parameters."""
        return isinstance(self.method, str) and self.method in _WITH_IDW

    def method_of(self, length: float) -> Method:
        """The method with these options; ``length`` is L_def of eq. 17 (grid length unit)."""
        chosen: Method = self.method
        if not self.has_idw:
            return chosen
        idw = IDW(
            rotation="lie" if self.useRotations else "none",
            alpha=self.alpha,
            a=self.aExp,
            b=self.bExp,
            length=self.LdefFact * length,
            smoothing="auto" if self.zeroCornerRotations else 0,
            summation="auto" if self.evalMode == "fast" else "exact",
            summation_tolerance=min(max(_PART * self.errTol, 1e-8), 0.1),
        )
        filler = _WITH_IDW[str(chosen)]
        return idw if filler is None else Hybrid(idw, filler())


_LOWER = {name.lower(): name for name in Options.__struct_fields__}


def known_name(name: str) -> str:
    """The name of an option, which is not case-sensitive; an unknown one is refused."""
    known = _LOWER.get(str(name).lower())
    if known is None:
        names = _LOWER.values()
        raise CaseError(f"unknown option {name!r}{suggestion(name, names)}; expected one of {', '.join(names)}")
    return known
