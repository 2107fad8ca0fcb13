"""A method on an overset grid: each component follows its own boundary."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, IntArray
from ..grid.connectivity.components import Component, assembled
from ..notices import Notice, kind_of
from ..parallel import alike, for_rows
from .base import Account, PreparedMethod, Problem, Progress

Prepared = PreparedMethod | None
"""A method prepared on a component; ``None`` for a component without moving boundaries, which remains at rest."""


class PreparedComponents:
    """A method prepared on every component.

    Parameters
    ----------
    methods : one for each of the problem's components
    """

    def __init__(self, problem: Problem, methods: tuple[Prepared, ...]):
        self.problem, self.methods = problem, methods
        self.sources = [
            np.searchsorted(problem.source_numbers, component.numbers[own.source_numbers])
            for component, own in problem.components
        ]

    @property
    def account(self) -> Account:
        """Settings and warnings of all components."""
        return account_of({component.name: method.account for (component, _), method, _ in self.parts if method})

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        found: list[str] = []
        for (component, _), method, rows in self.parts:
            if method:
                found += [named(component.name, text) for text in method.warnings_for(motion[rows], step[rows])]
        return found

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        moved = []
        for (component, _), method, rows in self.parts:
            moved.append((component, method.apply(displacement[rows], progress) if method else _still(component)))
        return assembled(self.problem.grid, moved)

    @property
    def parts(self) -> list[tuple[tuple[Component, Problem], Prepared, IntArray]]:
        """Each component with its problem, its method, and the rows of its sources among those of the whole grid."""
        return list(zip(self.problem.components, self.methods, self.sources, strict=True))


def _still(component: Component) -> FloatArray:
    found: FloatArray = alike(component.grid.points)
    for_rows(lambda rows: found[rows].fill(0.0), found)
    return found


def account_of(accounts: dict[str, Account]) -> Account:
    """The accounts of all components in one; a setting that differs between components is listed by component."""
    merged = Account()
    for key in dict.fromkeys(key for account in accounts.values() for key in account.settings):
        settings = {name: account.settings[key] for name, account in accounts.items() if key in account.settings}
        first = next(iter(settings.values()))
        alike = len(settings) == len(accounts) and all(each == first for each in settings.values())
        merged.settings |= {key: first} if alike else {f"{key} of {name}": each for name, each in settings.items()}
    for name, account in accounts.items():
        merged.notices |= {f"{name}: {kind}": named(name, text) for kind, text in account.notices.items()}
    return merged


def named(component: str, warning: str) -> Notice:
    """A warning with the name of its component."""
    return Notice(f"component {component!r}: {warning}", f"{component}: {kind_of(warning)}")
