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
from meshdeform_formats.picture import PlotOptions, Subject
from meshdeform_formats.picture.film import Common, film, save_film
from meshdeform_formats.picture.request import picture

SHIFTS = (0.0, 0.1, 0.3)


def levels():
    grid = frame_2d()
    topology = find_topology(grid)
    for shift in SHIFTS:
        moved = grid.points + shift * np.stack([np.sin(grid.points[:, 1]), *np.zeros((2, grid.n_nodes))], axis=1)
        yield f"shift {shift}", Subject(grid.moved(moved), topology, grid)


OF_DISPLACEMENT = PlotOptions("displacement")


def test_pictures_have_one_size_one_window_and_one_scale():
    pages = [picture(subject, OF_DISPLACEMENT, title) for title, subject in levels()]
    common = Common.of(pages[0])
    for page in pages[1:]:
        common = common.joined(Common.of(page))
    assert common.values == pytest.approx((0.0, 0.3 * np.sin(1.85)), abs=0.02)
    for page in pages:
        for panel, window in zip(page.panels, common.windows, strict=False):
            assert window[0] <= panel.window[0]
            assert window[3] >= panel.window[3]
    sizes = {png[16:24] for png in film(levels, OF_DISPLACEMENT)}
    assert len(sizes) == 1


def test_gif(tmp_path):
    save_film(film(levels, OF_DISPLACEMENT), tmp_path / "a.gif", 4.0)
    with Image.open(tmp_path / "a.gif") as found:
        assert found.n_frames == len(SHIFTS)
        assert found.info["duration"] == 250
        assert found.info["loop"] == 0
        frames = []
        for n in range(found.n_frames):
            found.seek(n)
            frames.append(np.asarray(found.convert("RGB"), dtype=float))
    # Only the grid and the title move: the colour bar and its numbers stay.
    changed = np.abs(frames[2] - frames[0]).max(axis=(0, 2)) > 40
    right = changed[int(0.9 * len(changed)) :]
    assert changed.any()
    assert not right.any()


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_mp4(tmp_path):
    save_film(film(levels, OF_DISPLACEMENT), tmp_path / "a.mp4", 5.0)
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
