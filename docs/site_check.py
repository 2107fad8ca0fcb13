"""The built site as a reader finds it: every picture and link of every page is there, and no Markdown is left over."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LEFT_OVER = re.compile(r"!\[[^\]]*\]\(")
_CODE = ("pre", "code", "script", "style", "textarea")


class _Page(HTMLParser):
    """Links and pictures of a page, its anchors, and its text outside code."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.text: list[str] = []
        self._code = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._code += tag in _CODE
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.append(value)
                if name == "src" or (tag == "link" and ("rel", "stylesheet") in attrs):
                    self.loaded.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)

    def handle_endtag(self, tag: str) -> None:
        self._code -= tag in _CODE

    def handle_data(self, data: str) -> None:
        if not self._code:
            self.text.append(data)


def broken(site: Path) -> list[str]:
    """What is wrong on the pages below ``site``: missing targets of links and pictures, what only another server has,
    Markdown shown as text."""
    pages = {path.resolve(): _parsed(path) for path in sorted(site.rglob("*.html"))}
    return [
        f"{path.relative_to(site.resolve())}: {flaw}"
        for path, page in pages.items()
        for flaw in _flaws(path, page, pages)
    ]


def _parsed(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def _flaws(path: Path, page: _Page, pages: dict[Path, _Page]) -> list[str]:
    found = ["Markdown of a picture is shown as text"] if _LEFT_OVER.search("".join(page.text)) else []
    found += [f"{link} is loaded from another server" for link in page.loaded if urlsplit(link).netloc]
    for link in page.links:
        parts = urlsplit(link)
        if parts.scheme or parts.netloc or path.name == "404.html":
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        target = target / "index.html" if target.is_dir() else target
        if not target.is_file():
            found.append(f"{link} does not exist")
        elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
            found.append(f"{link} has no such place")
    return found
