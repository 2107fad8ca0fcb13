"""One function per task: prepare a grid for many deformations, deform it once, judge, compare, sample; and methods."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import GIVEN
from meshdeform_core.deform import Case, set_up
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.grid.selection import Components
from meshdeform_core.memory import Demand, deforming, machine_memory, parse_memory
from meshdeform_core.mending import judge_grid
from meshdeform_core.methods import IDW, RBF, TFI, Options
from meshdeform_core.parallel import ONE_PROCESS, Ranks, WholeGridNeeded, sharing
from meshdeform_core.quality.difference import Difference, compare_points
from meshdeform_core.repair.options import Mode
from meshdeform_formats.case import CaseFile, case_of, read_case

from .grid import Grid, in_parts, user_grid, whole, whole_number, wrapped
from .mesh import Mesh, one_at_a_time
from .step import Step

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

__all__ = ["Difference", "Hybrid", "Sample", "compare", "deform", "prepare", "quality", "sample"]

Elementary = IDW | RBF | TFI
Selection = str | Sequence[str] | Mapping[str, str | Sequence[str]]
CaseLike = str | Path | Mapping[str, Any]


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
        # Refuses combinations that are not offered.
        options_of(self)


Method = str | IDW | RBF | TFI | Hybrid


def options_of(method: Method) -> Options:
    """The user's choice of method as options of a case; unknown or combined as is not offered, it is refused."""
    if isinstance(method, str):
        return Options(method)
    if not isinstance(method, IDW | RBF | TFI | Hybrid):
        raise MethodError(
            f"method = {method!r} is a {type(method).__name__}; expected a name like 'idw-tfi', IDW(...), RBF(...), "
            f"TFI(...) or Hybrid(mover, filler)"
        )
    parts = (method.mover, method.filler) if isinstance(method, Hybrid) else (method,)
    names = [type(part).__name__.lower() for part in parts]
    return Options("-".join(names), **dict(zip(names, parts, strict=True)))  # type: ignore[arg-type]


def prepare(
    grid: Grid | str | Path,
    case: CaseLike | None = None,
    *,
    moving: Selection | None = None,
    fixed: Selection | None = None,
    slip: Selection | None = None,
    symmetry: Selection | None = None,
    periodic: Selection | None = None,
    free: Selection | None = None,
    components: Components | None = None,
    method: Method | None = None,
    comm: Comm | None = None,
    threads: int | None = None,
    max_memory: int | str | None = None,
) -> Mesh:
    """Compute everything that does not depend on the displacement.

    Parameters
    ----------
    grid : a grid, or the name of a grid file
    case : a case file, or its content as a mapping; replaces selections and ``components``
    moving, fixed, slip, symmetry, periodic, free : patch names of the grid or block faces, like ``"wing"``,
        ``["wing", "block2.jmin[1:65,*]"]`` (each a separate patch) or ``{"body": ["wing", "tail"]}``. Outside faces
        that are not selected are fixed; ``free`` faces move along like the interior
    components : of an overset grid, each of which moves by its own boundary: ``"zone prefix"``, or patterns of block
        names like ``{"wing": ["wing*"], "flap": ["flap*"]}``
    method : a name like ``"idw-tfi"``, :class:`IDW`, :class:`RBF`, :class:`TFI` or :class:`Hybrid`; by default the
        case's method, ``"idw-tfi"`` if it has none
    comm : mpi4py communicator; each of its ranks holds and deforms its part of the grid, ``mesh.grid.part`` and
        ``step.grid.part``, as with ``mpiexec meshdeform deform``; every rank must make the same calls in the same order
    threads : largest number of threads; by default all cores available to the process
    max_memory : bytes, or a size like ``"2GiB"``; by default the available memory of the machine

    Raises
    ------
    MeshDeformError
        When a selection matches nothing, no node would move, options do not belong to the method, the grid does not
        fit into memory.
    """
    ranks, threads = ranks_of_comm(comm), whole_number(threads)
    if threads is not None and (isinstance(threads, bool) or not isinstance(threads, int) or threads < 1):
        raise CaseError(f"threads = {threads!r}; expected a whole number >= 1")
    selections = {
        Kind.MOVING: moving, Kind.FIXED: fixed, Kind.SLIP: slip, Kind.SYMMETRY: symmetry, Kind.PERIODIC: periodic,
        Kind.FREE: free,
    }  # fmt: skip
    with in_parts(), one_at_a_time(), sharing(threads=threads or ranks.cores):
        what = _case(case, selections, components)
        held = _grid_of(grid, what, ranks)
        chosen = what.case if method is None else dataclasses.replace(what.case, method=options_of(method))
        limit = machine_memory(ranks) if max_memory is None else parse_memory(str(max_memory), "max_memory", ranks)
        memory = Demand.of("deforming", deforming(chosen.method.name), held.core, ranks=ranks).left_of(limit)
        setup = set_up(held.core, chosen, memory=memory)
        return Mesh(setup, held.plane, ranks, threads)


def ranks_of_comm(comm: Comm | None) -> Ranks:
    """The ranks of a communicator; this process alone without one."""
    if comm is None:
        return ONE_PROCESS
    from meshdeform_core.parallel.ranks import MPIRanks

    return MPIRanks(comm)


def _grid_of(source: Grid | str | Path, what: CaseFile, ranks: Ranks) -> Grid:
    """The grid with the patches and components that the case names files for; in parts if there are several ranks."""
    try:
        grid = user_grid(source, ranks)
    except WholeGridNeeded:
        # Some files can only be read as a whole: each rank does, and keeps its part.
        grid = user_grid(source)
    if ranks.count == 1:
        whole(grid, "preparing it without comm=")
    own = grid.core
    if what.boundary_file is not None:
        from meshdeform_formats.neutral_map import read_neutral_map

        own = read_neutral_map(what.boundary_file, own)
    return wrapped(own.divided(ranks), grid.plane)


def _case(
    case: CaseLike | None, selections: Mapping[Kind, Selection | None], components: Components | None
) -> CaseFile:
    given = [kind.label for kind, selection in selections.items() if selection is not None]
    if case is not None:
        given += ["components"] * (components is not None)
        if given:
            raise CaseError(f"found a case and {', '.join(given)}; expected only one of them: the case says what moves")
        return parsed_case(case)
    if Kind.MOVING.label not in given:
        raise CaseError('nothing moves; expected moving = ["patch", ...], or a case')
    own = case_of({"grid": {"components": components or ""}}).case.components
    specs: list[BoundarySpec] = []
    for kind, selection in selections.items():
        for name, patterns in _entries(kind, selection).items():
            if name in (spec.name for spec in specs):
                raise CaseError(f"{kind.label}: {name!r} is selected twice; expected each patch once")
            specs.append(BoundarySpec(name, patterns, kind, motion=GIVEN if kind is Kind.MOVING else None))
    return CaseFile(Case(tuple(specs), components=own))


def parsed_case(case: CaseLike) -> CaseFile:
    """The case from a file or from a mapping with the same content."""
    if isinstance(case, str | Path):
        return read_case(case)
    if isinstance(case, Mapping):
        method = case.get("method")
        if method is None or isinstance(method, Mapping):
            return case_of(case)
        parsed = case_of({key: value for key, value in case.items() if key != "method"})
        return dataclasses.replace(parsed, case=dataclasses.replace(parsed.case, method=options_of(method)))
    raise CaseError(f"case is a {type(case).__name__}; expected the name of a case file, or a mapping with its content")


def _entries(kind: Kind, selection: Selection | None) -> dict[str, tuple[str, ...]]:
    """Selection patterns by patch name."""
    try:
        found = msgspec.convert(
            {} if selection is None else selection, str | tuple[str, ...] | dict[str, str | tuple[str, ...]]
        )
        if isinstance(found, str):
            found = (found,)
        if isinstance(found, tuple):
            if len(set(found)) < len(found):
                raise CaseError(f"{kind.label} = {list(found)} names a patch twice; expected each once")
            # Both sides of a periodic pair belong in one entry.
            found = {" and ".join(found): found} if kind is Kind.PERIODIC else dict(zip(found, found, strict=True))
        if all(found.values()):
            return {name: (one,) if isinstance(one, str) else one for name, one in found.items()}
    except msgspec.ValidationError:
        pass
    raise CaseError(
        f"{kind.label} = {selection!r}; expected patch names or block faces, like 'wing', ['wing', 'block2.jmin'] "
        f"or {{'body': ['wing', 'tail']}}"
    )


class Sample(NamedTuple):
    """A sample case: its grid, and its case in the form that :func:`deform` and :func:`prepare` accept."""

    grid: Grid
    case: dict[str, Any]


def deform(
    grid: Grid | str | Path,
    case: CaseLike,
    *,
    time: float = 0.0,
    steps: int | Literal["auto"] | None = None,
    repair: Mode | None = None,
    method: Method | None = None,
    threads: int | None = None,
    max_memory: int | str | None = None,
) -> Step:
    """Deform a grid once according to a case; see :func:`prepare` and :meth:`Mesh.deform` for the arguments."""
    mesh = prepare(grid, case, method=method, threads=threads, max_memory=max_memory)
    return mesh.deform(time=time, steps=steps, repair=repair)


def quality(
    grid: Grid | str | Path, reference: Grid | str | Path | None = None, case: CaseLike | None = None
) -> dict[str, Any]:
    """The quality report of a grid, by itself or against its original: a dictionary (see docs/report.md).

    Parameters
    ----------
    reference : the original grid, with the same blocks; cells that are valid there but not in ``grid`` are invalid
    case : defines the moving walls, for the measures at walls

    Raises
    ------
    GridError
        When the two have different blocks.
    """
    from meshdeform_formats.report.records import quality_report

    own = whole(user_grid(grid), "a report")
    what = parsed_case({} if case is None else case)
    original = None if reference is None else whole(user_grid(reference), "a report")
    assessment, notes = judge_grid(own, original or own, what.case)
    return quality_report(own, assessment, notes, original=original)


def compare(a: Grid | str | Path, b: Grid | str | Path) -> Difference:
    """Distance between corresponding nodes: ``largest``, ``rms``, ``where``, and per block.

    Raises
    ------
    GridError
        When the two have different blocks.
    """
    one, other = (whole(user_grid(grid), "a comparison") for grid in (a, b))
    return compare_points(one, other)


def sample(name: str, size: int | str | None = None) -> Sample:
    """A sample case; ``size`` is a number, whose meaning depends on the sample, or a name like ``"small"``.

    Raises
    ------
    CaseError
        For an unknown sample (listing the known ones) or an unsupported size.
    """
    from meshdeform_samples import case_content, generate

    if size is not None and (isinstance(size, bool) or not isinstance(size, int | str)):
        raise CaseError(f"size = {size!r}; expected a whole number or a name")
    grid, tables = generate(name, size)
    return Sample(wrapped(grid), case_content(name, tables))
