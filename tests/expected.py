"""What `formats/expected/` holds: reports, pages and templates, letter by letter; files with mistakes, and messages."""

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "formats" / "expected"


def text(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def entries(name: str) -> list:
    """Of three parts, for a test each: ``---- `` and a heading, the content of a file, ``==> `` and what is said."""
    found = re.findall(r"(?ms)^---- ?(.*?)\n(.*?)^==> (.*?)$", text(name))
    return [pytest.param(*parts, id=f"{number}: {parts[0][:50]}") for number, parts in enumerate(found, start=1)]


def with_messages(kind: str, contents: Mapping[str, object]) -> list:
    """The same of contents that a test makes, with their messages in messages.txt."""
    told = dict(line.split(" ==> ", 1) for line in text("messages.txt").splitlines())
    return [pytest.param(name, made, told[f"{kind}/{name}"], id=name) for name, made in contents.items()]


def check_message(error: BaseException | str, message: str, folder: Path) -> None:
    """Compare with a message, in which ``...`` is what another library says and files of ``folder`` have no folder."""
    found = str(error).replace(f"{folder}/", "")
    assert re.fullmatch(".*".join(map(re.escape, message.split("..."))), found, re.DOTALL), found
