"""Films: the same picture of every level of a series, as .gif or .mp4."""

from __future__ import annotations

import dataclasses
import io
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError

from ..files import replacing
from .page import FILMS, Page, page_png
from .request import PlotOptions, picture
from .subject import Subject
from .view import Window

_WIDTH, _DPI = 7.2, 110
_SAMPLES = 9
"""Number of pictures that the colours of a .gif are chosen from."""


@dataclasses.dataclass(frozen=True)
class Common:
    """Properties common to all pictures of a film, so that only the grid moves.

    ``windows`` of the panels, ``values``: lowest and highest, ``marks``: what the legend explains.
    """

    windows: tuple[Window, ...]
    values: tuple[float, float]
    marks: frozenset[str]

    @classmethod
    def of(cls, page: Page) -> Common:
        """The properties of a single picture."""
        values = np.concatenate([panel.scene.facets.values for panel in page.panels])
        known = values[np.isfinite(values)]
        low, high = float(known.min(initial=np.inf)), float(known.max(initial=-np.inf))
        return cls(tuple(panel.window for panel in page.panels), (low, high), page.explained)

    def joined(self, other: Common) -> Common:
        """The properties that cover both."""
        windows = tuple(one.joined(two) for one, two in zip(self.windows, other.windows, strict=False))
        values = min(self.values[0], other.values[0]), max(self.values[1], other.values[1])
        return Common(windows, values, self.marks | other.marks)


def check_film_path(path: Path) -> None:
    """Refuse, before anything is computed, an unknown suffix or one that needs a program that is not installed."""
    if path.suffix.lower() not in FILMS:
        raise FormatError(f"film {path}: suffix {path.suffix!r} is unknown; expected {' or '.join(FILMS)}")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise FormatError(f"{path}: .mp4 films need the program ffmpeg, which was not found; write a .gif")


def film(levels: Callable[[], Iterable[tuple[str, Subject]]], options: PlotOptions) -> Iterator[bytes]:
    """The pictures of a film, as PNG files of one size.

    Parameters
    ----------
    levels : gives title and grid of every level, in order; called twice
    options : what to draw of every grid
    """
    common: Common | None = None
    for title, subject in levels():
        found = Common.of(picture(subject, options, title))
        common = found if common is None else common.joined(found)
    if common is None:
        raise FormatError("the series has no level yet")
    scale = options.choice.scale_of(np.array(common.values))
    for title, subject in levels():
        page = picture(subject, dataclasses.replace(options, limits=(scale.low, scale.high)), title)
        panels = [
            dataclasses.replace(panel, window=window)
            for panel, window in zip(page.panels, common.windows, strict=False)
        ]
        page = dataclasses.replace(page, panels=tuple(panels), scale=scale, marks=common.marks)
        yield page_png(page, _WIDTH, _DPI)


def save_film(pictures: Iterable[bytes], path: Path, rate: float) -> None:
    """Write pictures (PNG files of one size) as a film of ``rate`` pictures per second."""
    check_film_path(path)
    with replacing(path) as partial:
        if path.suffix.lower() == ".gif":
            _save_gif(list(pictures), partial, rate)
        else:
            _save_mp4(pictures, partial, rate)


def _save_gif(pictures: list[bytes], path: Path, rate: float) -> None:
    from PIL import Image

    def opened(png: bytes) -> Image.Image:
        with Image.open(io.BytesIO(png)) as found:
            return found.convert("RGB")

    # One palette for all: several would flicker.
    chosen = np.unique(np.linspace(0, len(pictures) - 1, _SAMPLES).astype(int))
    sheet = np.concatenate([np.asarray(opened(pictures[n])) for n in chosen])
    palette = Image.fromarray(sheet).quantize(256)
    frames = [opened(png).quantize(palette=palette, dither=Image.Dither.NONE) for png in pictures]
    # The last picture is shown longer.
    each = round(1000 / rate)
    times = [each] * (len(frames) - 1) + [max(each, 800)]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, disposal=1)


def _save_mp4(pictures: Iterable[bytes], path: Path, rate: float) -> None:
    # Players expect even numbers of pixels and chroma at half the resolution.
    command = ["ffmpeg", "-loglevel", "error", "-y", "-f", "image2pipe", "-c:v", "png", "-framerate", f"{rate:g}",
               "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p",
               "-movflags", "+faststart", "-f", "mp4", str(path)]  # fmt: skip
    done = subprocess.run(command, input=b"".join(pictures), capture_output=True, check=False)
    if done.returncode:
        message = done.stderr.decode(errors="replace").strip()
        raise FormatError(f"ffmpeg could not write {path}: {message.splitlines()[-1] if message else 'no message'}")
