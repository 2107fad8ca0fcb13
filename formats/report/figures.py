"""Containers for the pictures of a report; :mod:`.illustrations` draws them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A picture, or the same view before and after (both PNG, of one size).

    ``names`` label the two; ``caption`` describes the picture, also for readers who cannot see it. Only a pair in the
    same window can have a ``slider``; others are shown side by side.
    """

    title: str
    caption: str
    after: bytes
    before: bytes | None = None
    slider: bool = True
    names: tuple[str, str] = ("before", "after")


@dataclass(frozen=True)
class Illustrations:
    """Pictures of one deformation, and thumbnails of the levels of a series with the files that they link to."""

    figures: tuple[Figure, ...] = ()
    thumbnails: tuple[tuple[Figure, str], ...] = ()


Illustrate = Callable[[], Illustrations]
