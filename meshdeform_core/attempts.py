"""How a motion is imposed: in a given number of steps, or adaptively so that the grid stays valid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from .boundary.crossing import find_contact
from .boundary.pinned import find_pinned
from .errors import MethodError
from .march import March, Trial
from .methods import Options
from .notices import Notice
from .repair.repair import COLLAPSING, HASTILY, QUICKLY

MAX_HALVINGS = 8
# The same for steps with a repair in each, which cost much more.
MAX_REPAIRED_HALVINGS = 4
MAX_ATTEMPTS = 24
"""Most steps tried with repairs, so that hopeless cases end."""
_BEFORE = 0.9
"""Where the boundary crosses itself, this share of the motion before that point is tried and reported to the user."""
RESCUE = "rbf-tfi"
"""The method tried when the chosen one finds no valid grid: it succeeds most often."""
SQUEEZED = ("tfi", RESCUE)
"""Those tried when the valid grid found is nearly collapsed: where the boundary leaves little room, lines between its
sides are often better kept by interpolation along them."""


def in_equal_steps(march: March, count: int) -> None:
    """Impose the motion in as many steps as the user asked for, valid or not."""
    march.warn_ahead(1 / count)
    for step in range(1, count + 1):
        march.accept(march.patient_trial(step / count))


def adaptively(march: March) -> None:
    """Impose the motion in one step if that keeps the grid valid; else halve this step and all that follow.

    Stops at the last valid grid when no step succeeds any more.
    """
    # Steps that are halved until they succeed are never too large.
    march.warn_ahead(0.0)
    increment, smallest = 1.0, 0.5**MAX_HALVINGS
    while march.fraction < 1.0:
        trial = march.trial(min(1.0, march.fraction + increment))
        if trial.verdict.valid:
            march.accept(trial)
        elif increment > smallest:
            increment /= 2
        else:
            march.failed = trial
            text = (
                f"only {march.fraction:.1%} of the motion was imposed; a further step of {increment:.2%} makes cells "
                f"invalid. The grid reached so far is kept"
            )
            march.warnings.append(Notice(text, "a part of the motion"))
            return


def until_valid(march: March) -> None:
    """Try one step with a repair, quick and then patient, then smaller steps with a repair in each, then the same with
    another method. Where the boundary alone shows that no valid grid exists, one step and a part of the motion, each
    with a short repair, are all that is tried.

    If the grid of one step is valid but nearly collapsed, the best one of several methods is taken.
    If nothing helps, the grid with the fewest invalid cells is kept, with its boundary where it was prescribed; the
    warnings say why, and for what part of the motion a valid grid was found.
    """
    march.warn_ahead(0.0)
    best, options = march.plain_trial(1.0), march.options
    impossible = None if best.verdict.valid else _find_impossible(march)
    best = march.repaired(best, HASTILY if impossible else QUICKLY)
    if impossible and not best.verdict.valid:
        march.warnings += impossible.reasons
        march.trial(_BEFORE * impossible.fraction, HASTILY)
    elif not best.verdict.valid:
        persistent = _persistently(march, best)
        if persistent is None:
            return
        best, options = persistent
    if best.verdict.valid and best.verdict.ratio.min() < COLLAPSING:
        for trial in _with_other_methods(march, SQUEEZED):
            if trial.verdict.valid and trial.verdict.ratio.min() > best.verdict.ratio.min():
                best, options = trial, march.options
    march.restart(options)
    march.accept(best)
    if not best.verdict.valid:
        _give_up(march)


def _persistently(march: March, best: Trial) -> tuple[Trial, Options] | None:
    """The best grid of one step, after a quick repair has failed, and its method; ``None`` when the motion has been
    imposed in smaller steps."""
    options, best = march.options, march.insist(best)
    if best.verdict.valid:
        return best, options
    if _in_smaller_steps(march):
        return None
    for trial in _with_other_methods(march, (RESCUE,)):
        other = trial if trial.verdict.valid else march.insist(trial)
        if len(other.verdict.invalid) < len(best.verdict.invalid):
            best, options = other, march.options
        if not best.verdict.valid and _in_smaller_steps(march):
            return None
    return best, options


def _in_smaller_steps(march: March) -> bool:
    """Take the largest steps that succeed, growing them again; return whether the whole motion was imposed."""
    increment, smallest = 0.5, 0.5**MAX_REPAIRED_HALVINGS
    while march.fraction < 1.0:
        if _enough(march):
            return False
        trial = march.trial(min(1.0, march.fraction + increment))
        if trial.verdict.valid:
            march.accept(trial)
            increment *= 2
        elif increment > smallest:
            increment /= 2
        else:
            return False
    return True


def _enough(march: March) -> bool:
    return len(march.attempts) >= MAX_ATTEMPTS or march.limit.reached


def _with_other_methods(march: March, names: tuple[str, ...]) -> Iterator[Trial]:
    """One step with each of some methods that fits into memory and is not the chosen one."""
    chosen = march.options.name
    for name in names:
        if name == chosen or _enough(march):
            continue
        march.restart(Options(name))
        try:
            yield march.trial(1.0)
        except MethodError as error:
            march.warnings.append(Notice(f"{name} was not tried: {error}", f"{name} not tried"))


@dataclass(frozen=True)
class _Impossible:
    """Why no valid grid exists, as far as the boundary alone shows it, and the ``fraction`` of the motion up to which
    that does not."""

    reasons: list[str]
    fraction: float


def _find_impossible(march: March) -> _Impossible | None:
    setup, motion = march.setup, march.motion
    contact = find_contact(setup.grid, setup.topology, setup.boundary, motion)
    pinned = find_pinned(setup.grid, setup.topology, setup.boundary, march.total)
    if contact is None:
        setup.examined.append(march.max_displacement)
    reasons: list[str] = [found.message for found in (contact, pinned) if found]
    return _Impossible(reasons, contact.fraction if contact else 1.0) if reasons else None


def _give_up(march: March) -> None:
    reached = max((a.reached for a in march.attempts if not a.invalid_cells), default=0.0)
    if march.limit.reached:
        march.warnings.append(f"the time limit of {march.limit.seconds:g} s was reached ([repair] time_limit)")
    part = f"only for {reached:.1%} of it" if reached else "nor for any part of it that was tried"
    text = (
        f"no valid grid was found for the whole motion, {part}. The grid kept has the whole "
        f"motion and the fewest invalid cells of {len(march.attempts)} attempts"
    )
    march.warnings.append(Notice(text, "no valid grid"))
