"""The default picture of grids that were once a line, a speck, or hidden behind the axes."""

from __future__ import annotations

import numpy as np
from grids import frame, plate_wing, plenum, thin_layers

from meshdeform_core.grid.faces.surfaces import find_outside
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats.case.template import case_template
from meshdeform_formats.picture.colours import Choice, colours_of
from meshdeform_formats.picture.overview import overview
from meshdeform_formats.picture.page import free_corner
from meshdeform_formats.picture.raster import render
from meshdeform_formats.picture.subject import Subject
from meshdeform_samples import load


def picture_of(grid):
    subject = Subject(grid, find_topology(grid))
    return subject, overview(subject, Choice())


def covered(panel):
    """The part of a panel in which something other than backdrop is drawn."""
    item = render(panel.scene, colours_of(panel.scene, None), panel.window, 100, 1).item
    return ((item >= 0) & (item < len(panel.scene.facets))).mean()


def test_a_plate_between_blocks_is_likely_a_wall_and_fills_the_picture():
    grid = plate_wing()
    subject, page = picture_of(grid)
    assert {plate.name for plate in subject.outside.plates} == {"block5.jmin", "block7.jmax"}
    np.testing.assert_allclose([plate.box[1] - plate.box[0] for plate in subject.outside.plates], [[1, 0, 1]] * 2)
    assert not page.panels[0].scene.view.flat
    assert covered(page.panels[0]) > 0.2
    text = case_template(grid, subject.outside, "wing.xyz")
    assert '# plates = ["block5.jmin", "block7.jmax"]' in text


def test_interfaces_and_wakes_are_no_plates():
    for grid in (frame(), load("airfoil").generate(41), load("wing").generate(8)):
        assert find_outside(grid, find_topology(grid)).plates == ()


def test_a_duct_fills_the_picture_and_the_wall_that_it_ends_in_is_behind_it():
    subject, page = picture_of(plenum())
    assert {body.name for body in subject.outside.bodies} == {
        f"block1.{side}" for side in ("jmin", "jmax", "kmin", "kmax")
    }
    assert covered(page.panels[0]) > 0.2
    assert page.panels[0].scene.view.towards[0] < 0


def test_thin_layers_have_a_close_up_of_the_first_cells():
    _, page = picture_of(thin_layers())
    _, near, nose = page.panels
    assert near.frames == (nose.window,)
    left, right, bottom, top = nose.window
    assert left < -0.5 < right
    assert bottom < 0 < top
    assert right - left < 0.05
    # Coarse cells are seen without it.
    assert "first cells" not in [panel.title for panel in picture_of(frame())[1].panels]


def test_the_axes_are_drawn_where_they_hide_least():
    panel = picture_of(load("wing").generate(8))[1].panels[0]
    item = render(panel.scene, colours_of(panel.scene, None), panel.window, 200, 1).item
    across, up = free_corner(item, len(panel.scene.facets), 0.25)
    drawn = (item >= 0) & (item < len(panel.scene.facets))
    side = drawn.shape[1] // 4
    rows, columns = np.s_[:side] if up else np.s_[-side:], np.s_[-side:] if across else np.s_[:side]
    assert not drawn[rows, columns].any()
