"""Pictures in a page: embedded PNG; pairs have a slider, or are shown side by side if scripts do not run."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from html import escape

from ..figures import Figure


def figure_lines(figure: Figure, number: int) -> Iterator[str]:
    """The figure with its heading."""
    yield f"<h3>{escape(figure.title)}</h3><figure>"
    if figure.before is None:
        yield f'<div class="single">{_image(figure.after, figure.title)}</div>'
    else:
        shown = zip(figure.names, (figure.before, figure.after), strict=True)
        sides = (f"<div><span>{name}</span>{_image(png, f'{figure.title}, {name}')}</div>" for name, png in shown)
        yield f'<div class="pair{" slider" if figure.slider else ""}">{"".join(sides)}</div>'
    if figure.before is not None and figure.slider:
        one, two = map(escape, figure.names)
        told = f"{escape(figure.title)}: part of the picture that shows {one}"
        yield (
            f'<label class="slide" for="slide{number}">{one}<input type="range" min="0" max="100" value="50" '
            f'id="slide{number}" aria-label="{told}">{two}</label>'
        )
    yield f"<figcaption>{escape(figure.caption)}</figcaption></figure>"


def thumbnail_lines(thumbnails: list[tuple[Figure, str]]) -> Iterator[str]:
    """Small pictures side by side, each linked to a file."""
    yield '<div class="thumbs">'
    for figure, link in thumbnails:
        yield (
            f'<figure><a href="{escape(link)}">{_image(figure.after, figure.title)}</a>'
            f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
        )
    yield "</div>"


def _image(png: bytes, text: str) -> str:
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    data = base64.b64encode(png).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" width="{width}" height="{height}" alt="{escape(text)}">'
