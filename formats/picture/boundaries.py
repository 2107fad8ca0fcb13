"""The boundaries of a grid by name, each in its colour."""

from __future__ import annotations

import dataclasses

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.numerics.geometry.vectors import doubled_areas

from .content.facets import Facets, block_outlines, joined
from .content.subject import Subject
from .content.walls import body_walls, corners_of, onto_walls
from .drawing.colours import colour_of, group_colours
from .drawing.image import Scene
from .drawing.page import Page, Panel
from .overview import Choice, overview
from .view import View, shaped, window_of

_MOST = 14


def boundaries(subject: Subject, title: str = "") -> Page:
    """All outside faces coloured by family, patch, or role where they have no name.

    In 3-D those that would hide the rest (far field and planes that face the viewer) are omitted; small walls have a
    close-up. In a plane grid the edges are coloured.
    """
    groups = _groups(subject)
    legend = tuple((name, colour_of(number)) for number, name in enumerate(groups))[:_MOST]
    if subject.grid.dimension == 2:
        page = overview(subject, Choice(), title)
        strokes = tuple(
            (corners_of(subject, surfaces), colour_of(number)) for number, surfaces in enumerate(groups.values())
        )
        flat = tuple(dataclasses.replace(panel, scene=_pale(panel.scene), strokes=strokes) for panel in page.panels)
        return dataclasses.replace(page, panels=flat, scale=None, legend=legend)
    view = onto_walls(subject)
    whole = _solid(subject, groups, view)
    panels = [whole]
    walls = body_walls(subject)
    if walls:
        near = shaped(window_of(view, corners_of(subject, walls), 0.1), (0.7, 1.0))
        if near[1] - near[0] < 0.5 * (whole.window[1] - whole.window[0]):
            panels.append(dataclasses.replace(whole, window=near, title="walls"))
    return Page(tuple(panels), title, None, legend)


def _pale(scene: Scene) -> Scene:
    """The cells in pale colours, so that the boundaries stand out."""
    return dataclasses.replace(scene, colours=np.full_like(scene.colours, 0.95))


def _groups(subject: Subject) -> dict[str, list[Surface]]:
    """Surfaces by the name that the legend shows, walls first."""
    groups: dict[str, list[Surface]] = {}
    for surface in sorted(subject.outside.surfaces, key=lambda s: list(Role).index(s.role)):
        guessed = "" if surface.declared or surface.role is Role.UNKNOWN else "?"
        name = f"{surface.name} ({surface.role.value}{guessed})" if surface.named else f"{surface.role.value}{guessed}"
        groups.setdefault(name, []).append(surface)
    return groups


def _solid(subject: Subject, groups: dict[str, list[Surface]], view: View) -> Panel:
    parts, quads = [], []
    for number, surfaces in enumerate(groups.values()):
        for surface in surfaces:
            corners = corners_of(subject, [surface])
            keep = np.ones(len(corners), bool) if surface.role is Role.WALL else _away(corners, view)
            parts.append(Facets.plain(corners[keep], number))
            quads.append(surface.quads[keep])
    facets = joined(parts)
    outlines = block_outlines(subject.grid, subject.topology, np.concatenate(quads))
    scene = Scene(facets, group_colours(facets), outlines, lit=True)
    return Panel(scene, view, shaped(window_of(view, facets.corners), (0.5, 1.1)), "outside")


def _away(corners: FloatArray, view: View) -> np.ndarray:
    """Quads (n, 4, 3) whose outer side faces away from the viewer: these hide nothing."""
    return np.asarray(doubled_areas(corners) @ view.towards < 0)
