"""Films: the same picture of every level of a series, as .gif or .mp4."""

from __future__ import annotations

import dataclasses
import io
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshdeform_core.errors import FormatError

from ..files import replacing
from .content.subject import Subject
from .drawing.colours import DIVERGING, SEQUENTIAL, Scale, scale_of
from .drawing.figure import FILMS, page_png
from .drawing.image import INVALID_COLOUR
from .drawing.page import Page
from .overview import Choice
from .request import Request, picture
from .view import Window

if TYPE_CHECKING:
    from PIL.Image import Image

_WIDTH, _DPI = 7.2, 110


@dataclasses.dataclass(frozen=True)
class Common:
    """Properties common to all pictures of a film, so that only the grid moves.

    ``windows`` of the panels, ``values``: lowest and highest, ``invalid``: a picture shows invalid cells.
    """

    windows: tuple[Window, ...]
    values: tuple[float, float]
    invalid: bool

    @classmethod
    def of(cls, page: Page) -> Common:
        """The properties of a single picture."""
        values = np.concatenate([panel.scene.facets.values for panel in page.panels])
        known = values[np.isfinite(values)]
        low, high = float(known.min(initial=np.inf)), float(known.max(initial=-np.inf))
        return cls(tuple(panel.window for panel in page.panels), (low, high), page.invalid > 0)

    def joined(self, other: Common) -> Common:
        """The properties that cover both."""
        windows = tuple(
            (min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3]))
            for a, b in zip(self.windows, other.windows, strict=False)
        )
        values = min(self.values[0], other.values[0]), max(self.values[1], other.values[1])
        return Common(windows, values, self.invalid or other.invalid)

    def scale(self, choice: Choice) -> Scale:
        """Colours for all values."""
        return scale_of(choice.metric, np.array(self.values), choice.limits, choice.logarithmic)

    def on(self, page: Page, scale: Scale) -> Page:
        """The page with these windows and the common colour bar."""
        panels = page.panels[: len(self.windows)]
        shown = tuple(dataclasses.replace(p, window=w) for p, w in zip(panels, self.windows, strict=True))
        return dataclasses.replace(page, panels=shown, scale=scale, explained=self.invalid)


def check_film_path(path: Path) -> None:
    """Refuse, before anything is computed, an unknown suffix or one that needs a program that is not installed."""
    if path.suffix.lower() not in FILMS:
        raise FormatError(f"film {path}: suffix {path.suffix!r} is unknown; expected {' or '.join(FILMS)}")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise FormatError(f"{path}: .mp4 films need the program ffmpeg, which was not found; write a .gif")


def film(levels: Callable[[], Iterable[tuple[str, Subject]]], request: Request) -> Iterator[bytes]:
    """The pictures of a film, as PNG files of one size.

    Parameters
    ----------
    levels : gives title and grid of every level, in order; called twice
    request : what to draw of every grid
    """
    common: Common | None = None
    for title, subject in levels():
        found = Common.of(picture(subject, request, title))
        common = found if common is None else common.joined(found)
    if common is None:
        raise FormatError("the series has no level yet")
    for title, subject in levels():
        scale = common.scale(request.choice)
        choice = dataclasses.replace(request.choice, limits=(scale.low, scale.high))
        page = picture(subject, dataclasses.replace(request, choice=choice), title)
        yield page_png(common.on(page, scale), _WIDTH, _DPI)


def save_film(pictures: Iterable[bytes], path: Path, rate: float) -> None:
    """Write pictures (PNG files of one size) as a film of ``rate`` pictures per second."""
    check_film_path(path)
    with replacing(path) as partial:
        if path.suffix.lower() == ".gif":
            _save_gif(pictures, partial, rate)
        else:
            _save_mp4(pictures, partial, rate)


def _save_gif(pictures: Iterable[bytes], path: Path, rate: float) -> None:
    palette = _palette()
    frames = [_reduced(png, palette) for png in pictures]
    # The last picture is shown longer.
    each = round(1000 / rate)
    times = [each] * (len(frames) - 1) + [max(each, 800)]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, disposal=1)


def _palette() -> Image:
    """The 256 colours of all pictures of a film: those of the colour maps, also under lines and shaded, and greys.

    A palette for each picture would flicker, and the colour bar would lose colours that no cell has.
    """
    from matplotlib import colormaps
    from PIL import Image

    places = np.concatenate([np.linspace(0, 1, n) for n in (64, 44, 28)])
    dark = np.repeat([1.0, 0.72, 0.5], (64, 44, 28))[:, None]
    maps = [np.array(colormaps[SEQUENTIAL](places))[:, :3] * dark]
    maps.append(np.array(colormaps[DIVERGING](np.linspace(0, 1, 64)))[:, :3])
    maps.append(np.linspace(0, 0.94, 44)[:, None] * np.ones(3))
    strong = np.array([INVALID_COLOUR, (0.75, 0.19, 0.0)])
    maps += [white + (1 - white) * strong for white in (0.0, 0.25, 0.5)]
    colours = np.concatenate([*maps, strong * 0.7, strong * 0.45, np.ones((2, 3))])
    image = Image.new("P", (1, 1))
    image.putpalette(np.round(255 * colours).astype(np.uint8).ravel().tolist())
    return image


def _reduced(png: bytes, palette: Image) -> Image:
    from PIL import Image

    with Image.open(io.BytesIO(png)) as picture:
        return picture.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE)


def _save_mp4(pictures: Iterable[bytes], path: Path, rate: float) -> None:
    # Players expect even numbers of pixels and chroma at half the resolution.
    command = ["ffmpeg", "-loglevel", "error", "-y", "-f", "image2pipe", "-c:v", "png", "-framerate", f"{rate:g}",
               "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p",
               "-movflags", "+faststart", "-f", "mp4", str(path)]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        try:
            for png in pictures:
                encoder.stdin.write(png)
            encoder.stdin.close()
        except BrokenPipeError:
            # ffmpeg has printed the reason on stderr.
            pass
        message = encoder.stderr.read().decode(errors="replace").strip()
    if encoder.returncode:
        raise FormatError(f"ffmpeg could not write {path}: {message.splitlines()[-1] if message else 'no message'}")
