"""Draw the pictures of the documentation: the sample cases deformed by every method, into docs/images.

Run from the repository: ``.venv/bin/python docs/make_pictures.py [NAME ...]``; without names all are drawn (minutes).
The report is photographed in a browser, the package PyQt6-WebEngine. Pictures in docs/images/pages are those of the
commands on the pages; ``PYTHONPATH=docs .venv/bin/python docs/build.py --pictures`` renews them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path

from PIL import Image

from meshdeform_cli.main import run
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats import read_grid
from meshdeform_formats.picture.page import Page, Scale, save_page
from meshdeform_formats.picture.scene import Window
from meshdeform_samples.reproduce.figures import drawn, scene_of

IMAGES = Path(__file__).resolve().parent / "images"
Panel = tuple[str, str, tuple[str, ...]]
"""Title, method, further options of ``deform``."""

PLATE_WINDOW = Window(-3.5, 8.5, -4.0, 5.5)


def picture(name: str, sample: str, size: int, panels: list[Panel], window: Window) -> None:
    """One picture with the deformed sample for every panel, side by side, coloured by f_skew."""
    with tempfile.TemporaryDirectory() as folder:
        case, shown = Path(folder), []
        call("sample", sample, "-o", case, "--size", size)
        for number, (title, method, options) in enumerate(panels):
            output = case / f"{number}.cgns"
            call("deform", case / "grid.cgns", "-c", case / "case.toml", "-m", method, *options, "-o", output,
                 "--repair", "off", "--allow-invalid", "-q")  # fmt: skip
            grid = read_grid(output)
            shown.append(drawn(scene_of(grid, find_topology(grid)), title, window))
        save_page(Page.of(shown, Scale("f_skew", (0.0, 1.0))), case / "picture.png")
        keep(case / "picture.png", name)


def keep(drawn: Path, name: str) -> None:
    """A palette is enough for one colour map and makes the file three times smaller."""
    small = Image.open(drawn).convert("RGB").quantize(256)
    small.save(IMAGES / f"{name}.png", optimize=True)


def call(*arguments: object) -> None:
    """Run a command of the program; anything but success ends this one."""
    code = run([str(argument) for argument in arguments])
    if code:
        raise SystemExit(code)


def plate(name: str, method: str, *options: str) -> Callable[[], None]:
    """The splitter plate at 30 degrees (the case of Sen et al., section 4), and at 45 degrees."""
    turned = ("-s", "constants.angle=45")
    panels = [(f"{method}, 30 degrees", method, options), (f"{method}, 45 degrees", method, (*options, *turned))]
    return lambda: picture(name, "splitter-plate", 8, panels, PLATE_WINDOW)


def rotations() -> None:
    """The beam of appendix B: what is averaged decides whether a symmetric motion gives a symmetric grid."""
    panels = [(f"rotation = {kind}", "idw", ("-s", f"method.idw.rotation={kind}"))
              for kind in ("none", "quaternion", "lie")]  # fmt: skip
    picture("rotations", "beam", 40, panels, Window(-2.0, 2.0, -1.0, 1.2))


def optimisation() -> None:
    """What the example draws: two grids, pressures, history."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, IMAGES.parents[1] / "examples" / "optimise.py", folder], check=True)
        keep(Path(folder) / "optimise.png", "optimise")


def report() -> None:
    """The page of a deformation with invalid cells, as docs/report.md describes it, on a screen and on a phone."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        call("sample", "splitter-plate", "-o", "case")
        call("deform", "case/grid.cgns", "-c", "case/case.toml", "-o", "far.cgns", "-s", "constants.angle=60",
             "--steps", 1, "--repair", "off", "--allow-invalid", "-q", "--report", "far.html")  # fmt: skip
        for name, width, scheme in (("light", 980, "light"), ("dark", 980, "dark"), ("phone", 420, "light")):
            subprocess.run(
                [
                    sys.executable,
                    IMAGES.parent / "photograph.py",
                    "far.html",
                    f"{name}.png",
                    str(width),
                    "1700",
                    scheme,
                ],
                check=True,
            )
            keep(Path(f"{name}.png"), f"report-{name}")


PICTURES: dict[str, Callable[[], None]] = {
    **{name: plate(name, name) for name in ("tfi-tfi", "rbf-rbf", "idw-idw", "rbf-tfi", "idw-rbf", "idw-tfi")},
    "rotations": rotations,
    "optimise": optimisation,
    "report": report,
}


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for wanted in sys.argv[1:] or PICTURES:
        PICTURES[wanted]()
