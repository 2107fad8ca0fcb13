"""An interactive view of a grid, with pyvista (the extra ``view``)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.planes import Plane

from ..files import replacing
from .content.end_plane import plane_of_grid
from .content.facets import Facets, block_outlines, joined, surface_facets
from .content.subject import Subject
from .content.walls import all_walls, body_walls, corners_of, middle_plane, onto_walls, quads_of
from .drawing.colours import Scale
from .drawing.image import INVALID_COLOUR
from .overview import Choice
from .view import View

if TYPE_CHECKING:
    import pyvista

_PALE, _NAN = (0.86, 0.87, 0.90), (0.86, 0.86, 0.87)
_MEASURE = "measure"


def scene(subject: Subject, choice: Choice, title: str = "", off_screen: bool = False) -> pyvista.Plotter:
    """A plotter with the walls, other boundaries, and a cut that can be dragged, coloured by a measure.

    Invalid cells are visible from everywhere. A plane grid is seen from above. In a window, each of the other
    boundaries has a check box that shows it.

    Raises
    ------
    CaseError
        Where pyvista is not installed.
    """
    pv = _pyvista()
    if off_screen:
        # Without a display, VTK tries several ways of rendering and prints errors for those that fail.
        pv.vtk_verbosity("off")
    plotter = pv.Plotter(off_screen=off_screen or None, title=f"meshdeform: {title}" if title else "meshdeform")
    plotter.set_background("white")
    flat = plane_of_grid(subject, choice.metric)
    if flat is not None:
        facets, outlines, view = flat
        scale = choice.scale(facets)
        _add_facets(plotter, facets, scale, choice.lines, lit=False)
        plotter.enable_parallel_projection()
        shown = facets.corners
    else:
        outlines, view, shown = _solid(plotter, subject, choice, off_screen)
    _add_lines(plotter, outlines)
    _add_invalid(plotter, subject)
    if title:
        plotter.add_text(title, font_size=9, color="black")
    plotter.add_axes(color="black", labels_off=False)
    _look(plotter, view, shown)
    return plotter


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise CaseError(
            "this needs pyvista, which is not installed: install meshdeform with its extra `view`, or pyvista itself"
        ) from error
    return pyvista


def _solid(
    plotter: pyvista.Plotter, subject: Subject, choice: Choice, off_screen: bool
) -> tuple[FloatArray, View, FloatArray]:
    """Add walls, other boundaries and a cut of a 3-D grid, and its outlines; set a view filled by the walls."""
    walls = all_walls(subject)
    quads = quads_of(walls) if walls else np.flatnonzero(subject.topology.external)
    surface = surface_facets(subject, quads, choice.metric)
    cells = _cells(subject, choice.metric)
    values = np.concatenate([block.cell_data[_MEASURE] for block in cells])
    inside = Facets(np.zeros((len(values), 1, 3)), values, np.zeros(len(values), bool), np.zeros(len(values), np.int64))
    scale = choice.scale(surface, inside)
    _add_facets(plotter, surface, scale, choice.lines)
    if walls:
        _add_cut(plotter, cells, middle_plane(subject), scale, off_screen)
        _add_others(plotter, subject, off_screen)
    bodies = body_walls(subject)
    filled = corners_of(subject, bodies) if bodies else surface.corners
    return block_outlines(subject.grid, subject.topology, quads), onto_walls(subject), filled


def _cells(subject: Subject, metric: str) -> Any:
    """The blocks as structured grids with the measure of their cells."""
    pv = _pyvista()
    blocks = pv.MultiBlock()
    for b, name in enumerate(subject.grid.names):
        block = pv.StructuredGrid(*np.moveaxis(subject.grid.block(b), 3, 0))
        block.cell_data[_MEASURE] = subject.values(metric, b, subject.whole(b)).ravel(order="F")
        blocks.append(block, name)
    return blocks


def _colours(scale: Scale) -> dict[str, Any]:
    return {
        "scalars": _MEASURE, "cmap": scale.map_name, "clim": (scale.low, scale.high), "log_scale": scale.logarithmic,
        "nan_color": _NAN, "copy_mesh": False,
        "scalar_bar_args": {"title": f"{scale.label}\n", "color": "black", "n_labels": 5, "fmt": "%.4g", "width": 0.6,
                            "height": 0.045, "position_x": 0.3, "position_y": 0.03, "title_font_size": 15,
                            "label_font_size": 13},
    }  # fmt: skip


def _add_facets(plotter: pyvista.Plotter, facets: Facets, scale: Scale, lines: bool, lit: bool = True) -> None:
    mesh = _polygons(facets.corners)
    mesh.cell_data[_MEASURE] = facets.values
    plotter.add_mesh(
        mesh, show_edges=lines, edge_color=(0.1, 0.11, 0.14), line_width=0.6, edge_opacity=0.6, lighting=lit,
        name="cells", **_colours(scale),
    )  # fmt: skip


def _polygons(corners: FloatArray) -> Any:
    """Polygons (n, m, 3) that share no nodes."""
    count, width = corners.shape[:2]
    faces = np.hstack([np.full((count, 1), width), np.arange(count * width).reshape(count, width)])
    return _pyvista().PolyData(corners.reshape(-1, 3), faces.ravel())


def _add_cut(plotter: pyvista.Plotter, cells: Any, plane: Plane, scale: Scale, off_screen: bool) -> None:
    """Add a cut through all blocks, draggable in a window."""
    normal, origin = tuple(plane.normal), tuple(plane.point)
    if off_screen:
        cut = cells.slice(normal=normal, origin=origin).combine()
        plotter.add_mesh(cut, show_edges=True, edge_opacity=0.25, lighting=False, name="cut", **_colours(scale))
        return
    plotter.add_mesh_slice(
        cells.combine(), normal=normal, origin=origin, lighting=False, name="cut", outline_translation=False,
        **_colours(scale),
    )  # fmt: skip


def _add_others(plotter: pyvista.Plotter, subject: Subject, off_screen: bool) -> None:
    """Add the other boundaries, initially hidden; in a window, each has a check box that shows it."""
    if off_screen:
        return
    height = 10
    for surface in subject.outside.surfaces:
        if surface.role is Role.WALL:
            continue
        actor = plotter.add_mesh(
            _polygons(surface_facets(subject, surface.quads).corners), color=_PALE, opacity=0.6, show_edges=True,
            edge_opacity=0.3, name=f"boundary {surface.name}",
        )  # fmt: skip
        actor.visibility = False
        plotter.add_checkbox_button_widget(
            actor.SetVisibility, value=False, position=(10, height), size=18, color_on="steelblue"
        )
        text = f"{surface.name} ({surface.role.value})"
        plotter.add_text(text, position=(36, height - 2), font_size=7, color="black", name=f"name {surface.name}")
        height += 26


def _add_lines(plotter: pyvista.Plotter, edges: FloatArray) -> None:
    if len(edges):
        plotter.add_mesh(
            _pyvista().line_segments_from_points(edges.reshape(-1, 3)), color="black", line_width=1.5, name="outlines"
        )


def _add_invalid(plotter: pyvista.Plotter, subject: Subject) -> None:
    """Add all faces of invalid cells."""
    parts = [_faces_of_cells(subject, b, np.argwhere(subject.bad(b, subject.whole(b)))) for b in
             range(subject.grid.n_blocks)]  # fmt: skip
    found = joined([Facets.plain(part) for part in parts])
    if len(found):
        label = [["invalid cells", INVALID_COLOUR]]
        plotter.add_mesh(_polygons(found.corners), color=INVALID_COLOUR, show_edges=True, name="invalid")
        plotter.add_legend(label, bcolor=None, face="rectangle", size=(0.16, 0.06), loc="upper right")


def _faces_of_cells(subject: Subject, block: int, cells: IntArray) -> FloatArray:
    """The faces (n, 4, 3) of cells (m, 3) of a block; of a plane grid the cells themselves."""
    x = subject.grid.block(block)
    around = ((0, 0), (1, 0), (1, 1), (0, 1))
    faces = []
    for axis in range(3):
        if subject.grid.dimension == 2 and x.shape[axis] > 1:
            continue
        others = [a for a in range(3) if a != axis]
        for end in (0,) if x.shape[axis] == 1 else (0, 1):
            at = np.repeat(cells[:, None], 4, axis=1)
            at[:, :, axis] += end
            for corner, steps in enumerate(around):
                at[:, corner, others] += steps
            faces.append(x[at[..., 0], at[..., 1], at[..., 2]])
    return np.concatenate(faces)


def _look(plotter: pyvista.Plotter, view: View, at: FloatArray) -> None:
    """Place the camera for a view, close enough for points (..., 3) to fill the picture."""
    low, high = at.reshape(-1, 3).min(axis=0), at.reshape(-1, 3).max(axis=0)
    plotter.camera.focal_point = tuple(0.5 * (low + high))
    plotter.camera.position = tuple(0.5 * (low + high) + view.towards)
    plotter.camera.up = tuple(view.up)
    plotter.reset_camera(bounds=np.stack([low, high], axis=1).ravel().tolist())


def save_screenshot(plotter: pyvista.Plotter, path: Path) -> None:
    """Write the picture of a plotter without a window to a .png file, which is replaced as a whole."""
    from PIL import Image

    pixels = plotter.screenshot(None, return_img=True)
    plotter.close()
    with replacing(path) as partial:
        Image.fromarray(pixels).save(partial, format="PNG")
