"""Choosing a method: a name, an elementary method, or a hybrid of two."""

from __future__ import annotations

from dataclasses import dataclass

from meshdeform_core.errors import MethodError
from meshdeform_core.methods import IDW, RBF, TFI, Options

Elementary = IDW | RBF | TFI


@dataclass(frozen=True)
class Hybrid:
    """``mover`` moves block interfaces and the faces of virtual sub-blocks, ``filler`` the interiors (Sen et al.).

    Attributes
    ----------
    mover : :class:`IDW`, :class:`RBF` or :class:`TFI`
    filler : :class:`TFI` or :class:`RBF`
    """

    mover: Elementary
    filler: Elementary

    def __post_init__(self) -> None:
        for role, part in (("mover", self.mover), ("filler", self.filler)):
            if not isinstance(part, IDW | RBF | TFI):
                raise MethodError(f"{role} = {part!r}; expected IDW(...), RBF(...) or TFI(...)")
        if type(self.mover) is type(self.filler) and self.mover != self.filler:
            raise MethodError(f"mover and filler differ: {self.mover} and {self.filler}; expected the same options")
        self.options  # noqa: B018  (refuses combinations that are not offered)

    @property
    def options(self) -> Options:
        """The equivalent options of a case."""
        return _options(f"{_name(self.mover)}-{_name(self.filler)}", self.mover, self.filler)


Method = str | IDW | RBF | TFI | Hybrid


def options_of(method: Method) -> Options:
    """Convert the user's choice of method to the options of a case.

    Raises
    ------
    MethodError
        For an unknown name, a combination that is not offered, or an object that is not a method.
    """
    if isinstance(method, str):
        return Options(method)
    if isinstance(method, Hybrid):
        return method.options
    if isinstance(method, IDW | RBF | TFI):
        return _options(_name(method), method)
    raise MethodError(
        f"method = {method!r} is a {type(method).__name__}; expected a name like 'idw-tfi', IDW(...), RBF(...), "
        f"TFI(...) or Hybrid(mover, filler)"
    )


def _name(part: Elementary) -> str:
    return type(part).__name__.lower()


def _options(name: str, *parts: Elementary) -> Options:
    return Options(name, **{_name(part): part for part in parts})  # type: ignore[arg-type]
