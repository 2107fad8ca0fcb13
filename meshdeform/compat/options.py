"""The options of IDWarp's meshes: honoured, mapped with a note, or refused."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.methods import IDW, RBF, TFI

from ..tasks import Hybrid, Method, options_of

_PART = 1e-3
"""Tolerance of fast sums (relative to the cell) as a fraction of ``errTol`` (relative to the displacement).

With it, finite differences with steps of 1e-6 agree with the derivative to 1e-7 (sample wing, 90,650 nodes), in 1.5
times the time that ``errTol`` itself would take.
"""
_WITH_IDW = {"idw": None, "idw-tfi": TFI, "idw-rbf": RBF}


def _positive(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise ValueError
    return float(value)


def _switch(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError
    return value


def _families(value: Any) -> list[str] | None:
    if isinstance(value, str) or not all(isinstance(each, str) for each in value or ()):
        raise ValueError
    return None if value is None else list(value)


def _planes(value: Any) -> list[tuple[tuple[float, ...], ...]] | None:
    planes = [tuple(tuple(float(x) for x in vector) for vector in plane) for plane in value or ()]
    if not all(len(plane) == 2 and all(len(vector) == 3 for vector in plane) and any(plane[1]) for plane in planes):
        raise ValueError
    return None if value is None else planes


def _method(value: Any) -> Any:
    # Names and objects alike: unknown ones are refused here, not at the first warp.
    if not _has_idw(value):
        options_of(value)
    return value


def _has_idw(method: object) -> bool:
    return isinstance(method, str) and method in _WITH_IDW


class Option(NamedTuple):
    """Default, a function that returns the value to use or raises ValueError, what it expects, and the meaning here
    where that differs from IDWarp's."""

    default: Any
    checked: Callable[[Any], Any] = lambda value: value
    expected: str = ""
    note: str = ""


def _number(default: float, note: str = "") -> Option:
    return Option(default, _positive, "a positive number", note)


def _one_of(default: str, known: tuple[str, ...], note: str = "", hint: str = "") -> Option:
    same = {each.lower(): each for each in known}

    def checked(value: Any) -> str:
        if str(value).lower() not in same:
            raise ValueError
        return same[str(value).lower()]

    return Option(default, checked, f"one of {', '.join(known)}{hint}", note)


OPTIONS = {
    "gridFile": Option(None),
    "fileType": _one_of("CGNS", ("CGNS", "PLOT3D"), hint="; unstructured meshes, as those of OpenFOAM, are not read"),
    "specifiedSurfaces": Option(None, _families, "a list of family names"),
    "symmetrySurfaces": Option(None, _families, "a list of family names"),
    "symmetryPlanes": Option(None, _planes, "[[[x, y, z], [nx, ny, nz]], ...], or [] for none"),
    "aExp": _number(3.0),
    "bExp": _number(5.0),
    "LdefFact": _number(1.0),
    "alpha": _number(0.25),
    "errTol": _number(
        0.0005, "fast sums err by at most a thousandth of it, relative to the shortest cell edge at a node"
    ),
    "evalMode": _one_of(
        "fast", ("fast", "exact"), "'fast' uses fast sums where they pay, exact ones for smaller grids"
    ),
    "symmTol": _number(1e-6),
    "useRotations": Option(
        True, _switch, "True or False", "rotations are averaged as twists (rotation = 'lie'), independent of the frame"
    ),
    "zeroCornerRotations": Option(
        True, _switch, "True or False",
        "rotations near sharp edges are averaged with those around them instead of being zeroed",
    ),
    "cornerAngle": _number(30.0, "edges are sharp from about 50 degrees on"),
    "restartFile": Option(None, note="nothing is read or written: preparing takes less time than reading it would"),
    "bucketSize": Option(8, note="has no effect: clusters are chosen by the tolerance"),
    # Additions to IDWarp's options.
    "method": Option("idw", _method),
    "repair": _one_of("off", ("off", "auto", "polish")),
}  # fmt: skip
_LOWER = {name.lower(): name for name in OPTIONS}


class Options:
    """Options by name, which is not case-sensitive; unknown ones, those given twice and wrong values are refused."""

    def __init__(self, given: Mapping[str, Any] | None):
        if not isinstance(given, Mapping):
            raise CaseError(f"options = {given!r}; expected a mapping with 'gridFile' and others")
        self._values = {name: option.default for name, option in OPTIONS.items()}
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
        option = OPTIONS[known]
        try:
            self._values[known] = option.checked(value)
        except (TypeError, ValueError):
            raise CaseError(f"{known} = {value!r}; expected {option.expected}") from None
        if known == "cornerAngle" and value != option.default:
            warnings.warn(f"{known} = {value!r} has no effect: {option.note}", stacklevel=4)

    def items(self) -> list[tuple[str, Any, str]]:
        """Every option with its value and its note, which may be empty."""
        return [(name, value, OPTIONS[name].note) for name, value in self._values.items()]

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
            raise CaseError(f"unknown option {name!r}{suggestion(name, OPTIONS)}; expected one of {', '.join(OPTIONS)}")
        return known
