"""Build the site (`make docs`): pages, generated reference, gallery; then mkdocs, which fails on a dead link;
at last every built page is opened in a parser.

``--quick`` leaves out the gallery, which deforms every sample; ``--pictures`` runs the commands of the pages first and
renews the pictures that they show.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from site_check import broken
from site_gallery import gallery_page
from site_pages import renew_pictures
from site_reference import command_page, python_page

ROOT = Path(__file__).parents[1]
DOCS, TARGET = ROOT / "docs", ROOT / "build" / "docs"
FROM_ROOT = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md")


def main(options: list[str]) -> int:
    """Put everything together; returns the exit code: that of mkdocs, or 1 if a page has a flaw."""
    if "--pictures" in options:
        renew_pictures(DOCS)
    shutil.rmtree(TARGET, ignore_errors=True)
    TARGET.mkdir(parents=True)
    for suffix in ("md", "png", "css", "js", "json"):
        for source in DOCS.rglob(f"*.{suffix}"):
            copy(source, TARGET / source.relative_to(DOCS))
    for name in FROM_ROOT:
        copy(ROOT / name, TARGET / name)
    generated = {
        "reference/commands.md": command_page(),
        "reference/python.md": python_page(),
        "gallery.md": gallery_page(TARGET / "gallery", quick="--quick" in options),
    }
    for name, text in generated.items():
        (TARGET / name).parent.mkdir(parents=True, exist_ok=True)
        (TARGET / name).write_text(text, encoding="utf-8")
    settings = TARGET.parent / "mkdocs.yml"
    settings.write_text(without_missing((DOCS / "mkdocs.yml").read_text(encoding="utf-8")), encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", str(settings)]
    if code := subprocess.run(command, check=False).returncode:
        return code
    flaws = broken(TARGET.parent / "site")
    print(*flaws, sep="\n", file=sys.stderr)
    return 1 if flaws else 0


def without_missing(settings: str) -> str:
    """The settings without pages that are not there: the tables of contents may be ahead of the pages."""
    lines = settings.splitlines()
    links = [re.fullmatch(r"\s*- [^:]+: (\S+\.md)", line) for line in lines]
    return "\n".join(
        line for line, link in zip(lines, links, strict=True) if link is None or (TARGET / link[1]).is_file()
    )


def copy(source: Path, target: Path) -> None:
    """Copy a file; links of pages lead to where the pages of the repository's root are on the site, and those whose
    text is a file's name show the title of its page.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.suffix != ".md":
        shutil.copyfile(source, target)
        return
    text = source.read_text(encoding="utf-8")
    text = re.sub(r"\[[\w/]+\.md\](?=\((?!https:)([^):#]+))", lambda link: f"[{title(source.parent / link[1])}]", text)
    text = re.sub(r"\]\(\.\./(ARCHITECTURE|CHANGELOG|CONTRIBUTING)\.md", r"](\1.md", text)
    text = re.sub(r"\]\(docs/", "](", text)
    target.write_text(text, encoding="utf-8")


def title(page: Path) -> str:
    """The heading of a page."""
    return page.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
