"""The options of IDWarp's meshes: honoured, mapped with a note, or refused."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.methods import IDW, RBF, TFI

from ..choice import Hybrid, Method, options_of

DEFAULTS: dict[str, Any] = {
    "gridFile": None,
    "fileType": "CGNS",
    "specifiedSurfaces": None,
    "symmetrySurfaces": None,
    "symmetryPlanes": None,
    "aExp": 3.0,
    "bExp": 5.0,
    "LdefFact": 1.0,
    "alpha": 0.25,
    "errTol": 0.0005,
    "evalMode": "fast",
    "symmTol": 1e-6,
    "useRotations": True,
    "zeroCornerRotations": True,
    "cornerAngle": 30.0,
    "restartFile": None,
    "bucketSize": 8,
    # Additions to IDWarp's options.
    "method": "idw",
    "repair": "off",
}
"""Options and their defaults; the last two are additions to IDWarp's."""

NOTES = {
    "errTol": "fast sums err by at most a thousandth of it, relative to the shortest cell edge at a node",
    "evalMode": "'fast' uses fast sums where they pay, exact ones for smaller grids",
    "useRotations": "rotations are averaged as twists (rotation = 'lie'), independent of the frame",
    "zeroCornerRotations": "rotations near sharp edges are averaged with those around them instead of being zeroed",
    "cornerAngle": "edges are sharp from about 50 degrees on; only the default, 30, is accepted",
    "restartFile": "nothing is read or written: preparing takes less time than reading it would",
    "bucketSize": "has no effect: clusters are chosen by the tolerance",
}
"""Meaning of options here where it differs from IDWarp's."""

_PART = 1e-3
"""Tolerance of fast sums (relative to the cell) as a fraction of ``errTol`` (relative to the displacement).

With it, finite differences with steps of 1e-6 agree with the derivative to 1e-7 (sample wing, 90,650 nodes), in 1.5
times the time that ``errTol`` itself would take.
"""
_WITH_IDW = {"idw": None, "idw-tfi": TFI, "idw-rbf": RBF}
_LOWER = {name.lower(): name for name in DEFAULTS}
_POSITIVE = ("aExp", "bExp", "LdefFact", "alpha", "errTol", "symmTol", "cornerAngle")
_SWITCHES = ("useRotations", "zeroCornerRotations")


class Options:
    """Options by name, which is not case-sensitive.

    Raises
    ------
    CaseError
        Without options, for an unknown option (naming the nearest known one), one given twice, or a refused value.
    """

    def __init__(self, given: Mapping[str, Any] | None):
        if not isinstance(given, Mapping):
            raise CaseError(f"options = {given!r}; expected a mapping with 'gridFile' and others")
        self._values = dict(DEFAULTS)
        spelled: dict[str, str] = {}
        for name, value in given.items():
            self.set(name, value)
            if (other := spelled.setdefault(self._known(name), name)) != name:
                raise CaseError(f"found both {other!r} and {name!r}; expected an option once, in any case")
        if not isinstance(self._values["gridFile"], str):
            raise CaseError(f"gridFile = {self._values['gridFile']!r}; expected the name of a grid file")
        if self._values["fileType"] == "PLOT3D" and self._values["symmetryPlanes"] is None:
            raise CaseError(
                "symmetryPlanes is missing: a Plot3D file holds no boundary conditions; expected a list of planes, "
                "[[point, normal], ...], or [] for none"
            )

    def __getitem__(self, name: str) -> Any:
        return self._values[self._known(name)]

    def set(self, name: str, value: Any) -> None:
        """Change an option."""
        known = self._known(name)
        self._values[known] = _checked(known, value)

    def items(self) -> list[tuple[str, Any, str]]:
        """Every option with its value and its note, which may be empty."""
        return [(name, value, NOTES.get(name, "")) for name, value in self._values.items()]

    def method(self, length: float) -> Method:
        """The method with these options; ``length`` is L_def of eq. 17 (grid length unit)."""
        v = self._values
        chosen: Method = v["method"]
        if not _has_idw(chosen):
            return chosen
        idw = IDW(
            rotation="lie" if v["useRotations"] else "none",
            alpha=v["alpha"],
            a=v["aExp"],
            b=v["bExp"],
            length=v["LdefFact"] * length,
            smoothing="auto" if v["zeroCornerRotations"] else 0,
            summation="auto" if v["evalMode"] == "fast" else "exact",
            summation_tolerance=min(max(_PART * v["errTol"], 1e-8), 0.1),
        )
        filler = _WITH_IDW[str(chosen)]
        return idw if filler is None else Hybrid(idw, filler())

    @staticmethod
    def _known(name: str) -> str:
        known = _LOWER.get(str(name).lower())
        if known is None:
            raise CaseError(
                f"unknown option {name!r}{suggestion(name, DEFAULTS)}; expected one of {', '.join(DEFAULTS)}"
            )
        return known


def _has_idw(method: object) -> bool:
    return isinstance(method, str) and method in _WITH_IDW


def _checked(name: str, value: Any) -> Any:
    if name in _POSITIVE:
        return _positive(name, value)
    if name in _SWITCHES and not isinstance(value, bool):
        raise CaseError(f"{name} = {value!r}; expected True or False")
    if name == "fileType":
        return _file_type(value)
    if name == "evalMode":
        return _one_of(name, value, ("fast", "exact"))
    if name == "repair":
        return _one_of(name, value, ("off", "auto", "polish"))
    if name in ("specifiedSurfaces", "symmetrySurfaces") and value is not None:
        return _families(name, value)
    if name == "symmetryPlanes" and value is not None:
        return _planes(value)
    if name == "method" and not _has_idw(value):
        # Names and objects alike: unknown ones are refused here, not at the first warp.
        options_of(value)
    return value


def _positive(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise CaseError(f"{name} = {value!r}; expected a positive number")
    if name == "cornerAngle" and value != DEFAULTS[name]:
        raise CaseError(
            f"cornerAngle = {value!r} is not offered: edges are sharp from about 50 degrees on; expected the default, "
            f"{DEFAULTS[name]}, or zeroCornerRotations = False, which treats all edges alike"
        )
    return float(value)


def _file_type(value: Any) -> str:
    if str(value).lower() == "openfoam":
        raise CaseError(
            "fileType = 'OpenFOAM': its meshes are unstructured; expected CGNS or PLOT3D, the structured grid from "
            "which the mesh was made"
        )
    return _one_of("fileType", value, ("cgns", "plot3d")).upper()


def _one_of(name: str, value: Any, known: tuple[str, ...]) -> str:
    if str(value).lower() not in known:
        raise CaseError(f"{name} = {value!r}; expected one of {', '.join(known)}")
    return str(value).lower()


def _families(name: str, value: Any) -> list[str]:
    if isinstance(value, str) or not all(isinstance(each, str) for each in value):
        raise CaseError(f"{name} = {value!r}; expected a list of family names")
    return list(value)


def _planes(value: Any) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    try:
        planes = [tuple(tuple(float(x) for x in vector) for vector in plane) for plane in value]
        if all(len(plane) == 2 and all(len(vector) == 3 for vector in plane) and any(plane[1]) for plane in planes):
            return planes  # type: ignore[return-value]
    except (TypeError, ValueError):
        pass
    raise CaseError(f"symmetryPlanes = {value!r}; expected [[[x, y, z], [nx, ny, nz]], ...], or [] for none")
