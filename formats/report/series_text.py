"""The levels of a series as a text table."""

from __future__ import annotations

from collections.abc import Iterator

from .records import Report

ACCELERATION = "largest acceleration of a node, in the largest step of the walls; 2 where they turn back"


def series_lines(report: Report) -> Iterator[str]:
    """The levels as lines of a table."""
    series, levels = report["series"], report["levels"]
    before = report["quality"]["before"]["f_skew"]
    yield f"series    {series['levels']} levels, each from the {_ORIGINS[series['origin']]}"
    if series["view"]:
        yield f"          open {series['view']} in ParaView"
    yield f"          f_skew of the undeformed grid: mean {before['harmonic_mean']:.4f}, minimum {before['min']:.4f}"
    yield (
        f"level     {'time':>12s} {'moved':>10s} {'turned':>8s} {'f_skew':>7s} {'min':>7s} {'invalid':>8s}"
        f" {'accel.':>8s} {'repaired':>8s} {'drift':>9s} {'prepare':>8s} {'apply':>8s} {'total s':>8s}"
    )
    for level in levels:
        skew, drift, timing = level["quality"]["f_skew"], level["drift"], level["timing"]
        shown = f"{drift['max']:9.2e}" if drift else f"{'':9s}"
        found = acceleration_of(level)
        acceleration = "" if found is None else f"{found:8.3f}"
        yield (
            f"{level['number']:5d}     {level['time']:12.6g} {level['max_displacement']:10.4g} "
            f"{level['max_rotation_deg']:7.2f}° {skew['harmonic_mean']:7.4f} {skew['min']:7.4f} "
            f"{level['quality']['invalid_cells']:8,} {acceleration:>8s} {repaired(level):>8s} {shown} "
            f"{timing.get('prepare', 0.0):8.2f} {timing.get('apply', 0.0):8.2f} {timing['total']:8.2f}"
        )
    if any(acceleration_of(level) is not None for level in levels):
        yield f"accel.    {ACCELERATION}"
    if series["drift"]:
        yield (
            f"drift     {series['drift']['max']:.3g} at most, {series['drift']['rms']:.3g} rms: distance of the last "
            f"level from the grid made from the undeformed one"
        )


def acceleration_of(level: Report) -> float | None:
    """The largest acceleration of a node in steps of the walls; ``None`` where earlier levels are missing."""
    found: float | None = (level.get("smoothness") or {}).get("acceleration")
    return found


def repaired(level: Report) -> str:
    """Whether nodes were moved by a repair: ``yes`` to its minimum, ``other`` elsewhere, ``no``
    if it was left out."""
    repair = level.get("repair")
    if not repair:
        return ""
    if repair["left_out"]:
        return "no"
    return "yes" if repair["converged"] else "other"


_ORIGINS = {"reference": "undeformed grid", "last": "previous level (marching)"}
