"""The grid in a window, drawn without one."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from grids import frame_2d, polar

import meshdeform as md
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats.picture import Choice, Subject
from meshdeform_formats.picture import viewer as viewer_module
from meshdeform_formats.picture.drawing.image import INVALID_COLOUR
from meshdeform_samples import generate


def wing() -> Subject:
    grid, _ = generate("wing", 8)
    return Subject(grid, find_topology(grid))


def broken(grid: Grid) -> Subject:
    """The grid with a node pulled far out of its place."""
    points = grid.points.copy()
    points[grid.n_nodes // 2] += 0.6 * np.ptp(points, axis=0)
    return Subject(grid.moved(points), find_topology(grid), grid)


def shot(subject: Subject, choice: Choice) -> np.ndarray:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    plotter = viewer_module.scene(subject, choice, "title", off_screen=True)
    pixels = plotter.screenshot(None, return_img=True)
    plotter.close()
    return np.asarray(pixels) / 255


def near(pixels: np.ndarray, colour: tuple[float, float, float], by: float = 0.2) -> int:
    """How many pixels have about this colour."""
    return int((np.abs(pixels - colour).max(axis=-1) < by).sum())


def test_a_wing_and_its_cut_fill_the_picture():
    pixels = shot(wing(), Choice())
    assert (pixels.min(axis=-1) < 0.9).mean() > 0.3
    # Good cells are yellow.
    assert near(pixels, (0.99, 0.9, 0.14)) > 10_000


@pytest.mark.parametrize("grid", [polar(), frame_2d()], ids=["space", "plane"])
def test_invalid_cells_are_seen(grid):
    assert near(shot(broken(grid), Choice()), INVALID_COLOUR) > 100
    assert near(shot(Subject(grid, find_topology(grid), grid), Choice()), INVALID_COLOUR, 0.1) == 0


def test_faces_of_cells_are_their_quads():
    subject = Subject(polar(), find_topology(polar()))
    faces = viewer_module._faces_of_cells(subject, 0, np.array([[3, 2, 1]]))
    corners = subject.grid.block(0)[3:5, 2:4, 1:3].reshape(-1, 3)
    assert faces.shape == (6, 4, 3)
    # Every corner is on three of the six faces, and no face has one twice.
    count = [(np.abs(faces - corner).max(axis=-1) == 0).sum() for corner in corners]
    assert count == [3] * 8
    assert all(len(np.unique(face, axis=0)) == 4 for face in faces)


def test_grid_view_is_a_plotter(monkeypatch):
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    plotter = md.sample("wing", 8).grid.view("volume", log=True)
    assert isinstance(plotter, pyvista.Plotter)
    # The cut can be dragged, and each of the other boundaries has a box.
    widgets = getattr(plotter, "widgets", plotter)
    assert len(widgets.plane_widgets) == 1
    hidden = [name for name, actor in plotter.actors.items() if name.startswith("boundary") and not actor.visibility]
    assert len(widgets.button_widgets) == len(hidden) >= 2
    plotter.close()


def test_without_pyvista_the_message_names_the_extra(monkeypatch):
    real = builtins.__import__

    def missing(name, *rest):
        if name == "pyvista":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(CaseError, match="extra `view`"):
        viewer_module.scene(wing(), Choice())
