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


def check_film_path(path: Path) -> None:
    """Refuse, before anything is computed, an unknown suffix or one that needs a program that is not installed."""
    if path.suffix.lower() not in FILMS:
        raise FormatError(f"film {path}: suffix {path.suffix!r} is unknown; expected {' or '.join(FILMS)}")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise FormatError(f"{path}: .mp4 films need the program ffmpeg, which was not found; write a .gif")


def film_pages(levels: Callable[[], Iterable[tuple[str, Subject]]], options: PlotOptions) -> Iterator[Page]:
    """The pages of a film, in common windows and colours, so that only the grid moves.

    Parameters
    ----------
    levels : gives title and grid of every level, in order; called twice
    options : what to draw of every grid
    """
    windows: list[Window] = []
    ends: list[float] = []
    marks: frozenset[str] = frozenset()
    for title, subject in levels():
        page = picture(subject, options, title)
        windows = windows or [panel.window for panel in page.panels]
        windows = [one.joined(panel.window) for one, panel in zip(windows, page.panels, strict=False)]
        values = np.concatenate([panel.scene.facets.values for panel in page.panels])
        if (known := values[np.isfinite(values)]).size:
            ends += [float(known.min()), float(known.max())]
        marks |= page.explained
    if not windows:
        raise FormatError("the series has no level yet")
    scale = options.choice.scale(np.array(ends))
    for title, subject in levels():
        page = picture(subject, dataclasses.replace(options, limits=(scale.low, scale.high)), title)
        panels = [dataclasses.replace(panel, window=w) for panel, w in zip(page.panels, windows, strict=False)]
        yield dataclasses.replace(page, panels=tuple(panels), scale=scale, marks=marks)


def film(levels: Callable[[], Iterable[tuple[str, Subject]]], options: PlotOptions) -> Iterator[bytes]:
    """The pictures of a film as PNG files of one size, see :func:`film_pages`."""
    return (page_png(page, _WIDTH, _DPI) for page in film_pages(levels, options))


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
