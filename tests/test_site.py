"""The check of the built site finds what a reader would stumble over; `make docs` runs it on the site."""

from __future__ import annotations

from site_check import broken

PAGE = "<html><body><h2 id='here'>x</h2>{}</body></html>"


def write(folder, name: str, body: str) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(PAGE.format(body))


def test_a_sound_site_has_no_flaw(tmp_path):
    (tmp_path / "p.png").write_bytes(b"x")
    write(tmp_path, "index.html", "<img src='p.png'><a href='a/#here'>a</a><a href='https://x.org/'>x</a>")
    write(tmp_path, "a/index.html", "<a href='../index.html'>up</a><code>![a](b)</code>")
    assert broken(tmp_path) == []


def test_what_a_reader_would_stumble_over_is_found(tmp_path):
    """Missing pictures, links and places, Markdown shown as text, and what would need a network."""
    write(
        tmp_path,
        "index.html",
        "<img src='gone.png'><a href='#nowhere'>a</a><a href='no/page/'>b</a>"
        "<figure>![wing, grid](gallery/wing.png)</figure>"
        "<script src='https://x.org/a.js'></script><link rel='stylesheet' href='//x.org/a.css'>",
    )
    assert sorted(broken(tmp_path)) == [
        "index.html: #nowhere has no such place",
        "index.html: //x.org/a.css is loaded from another server",
        "index.html: Markdown of a picture is shown as text",
        "index.html: gone.png does not exist",
        "index.html: https://x.org/a.js is loaded from another server",
        "index.html: no/page/ does not exist",
    ]
