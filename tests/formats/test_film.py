"""Films of a series: pictures that share windows and colours, files that other programs read."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from grids import frame_2d
from PIL import Image

from meshdeform_core.errors import FormatError
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats.picture.film import film, film_pages, save_film
from meshdeform_formats.picture.request import PlotOptions, picture
from meshdeform_formats.picture.subject import Subject

SHIFTS = (0.0, 0.1, 0.3)


def levels():
    grid = frame_2d()
    topology = find_topology(grid)
    for shift in SHIFTS:
        moved = grid.points + shift * np.stack([np.sin(grid.points[:, 1]), *np.zeros((2, grid.n_nodes))], axis=1)
        yield f"shift {shift}", Subject(grid.moved(moved), topology, grid)


OF_DISPLACEMENT = PlotOptions("displacement")


@pytest.fixture(scope="module")
def pictures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("meshdeform_formats.picture.film._DPI", 50)
        return list(film(levels, OF_DISPLACEMENT))


def test_common_windows_and_colours_cover_all_pictures():
    pages = list(film_pages(levels, OF_DISPLACEMENT))
    assert {page.scale for page in pages} == {pages[0].scale}
    assert (pages[0].scale.low, pages[0].scale.high) == pytest.approx((0.0, 0.3 * np.sin(1.85)), abs=0.02)
    for page, (title, subject) in zip(pages, levels(), strict=True):
        for panel, own in zip(page.panels, picture(subject, OF_DISPLACEMENT, title).panels, strict=True):
            assert panel.window == pages[0].panels[page.panels.index(panel)].window
            assert own.window.within(panel.window) == own.window


def test_gif(pictures, tmp_path):
    assert len({png[16:24] for png in pictures}) == 1
    save_film(pictures, tmp_path / "a.gif", 4.0)
    with Image.open(tmp_path / "a.gif") as found:
        assert (found.n_frames, found.info["duration"], found.info["loop"]) == (len(SHIFTS), 250, 0)
        frames = []
        for n in (0, 2):
            found.seek(n)
            frames.append(np.asarray(found.convert("RGB"), dtype=float))
    # Only the grid and the title move: the colour bar and its numbers stay.
    changed = np.abs(frames[1] - frames[0]).max(axis=(0, 2)) > 40
    assert changed.any()
    assert not changed[int(0.9 * len(changed)) :].any()


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_mp4(pictures, tmp_path):
    save_film(pictures, tmp_path / "a.mp4", 5.0)
    ask = ["ffprobe", "-v", "error", "-select_streams", "v", "-show_entries", "stream=nb_frames,r_frame_rate", "-of",
           "csv=p=0", str(tmp_path / "a.mp4")]  # fmt: skip
    assert subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip() == f"5/1,{len(SHIFTS)}"


def test_without_ffmpeg_mp4_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FormatError, match=r"write a \.gif"):
        save_film([], tmp_path / "a.mp4", 5.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_what_ffmpeg_refuses_leaves_no_file(tmp_path):
    with pytest.raises(FormatError, match="ffmpeg could not write"):
        save_film([b"no picture"], tmp_path / "a.mp4", 5.0)
    assert list(tmp_path.iterdir()) == []
