"""One function per task: deform once, judge, compare, sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

from meshdeform_core.errors import CaseError
from meshdeform_core.mending import judge_grid
from meshdeform_core.quality.difference import Difference, compare_points
from meshdeform_core.repair.options import Mode

from .choice import Method
from .grid import Grid, user_grid, whole, wrapped
from .preparation import CaseLike, parsed_case, prepare
from .step import Step

__all__ = ["Difference", "Sample", "compare", "deform", "quality", "sample"]


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
