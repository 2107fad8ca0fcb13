"""Messages that the pages quote are messages that the program gives."""

from __future__ import annotations

import ast
import errno
import os
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
ROWS = [line.split(" | ")[0] for line in PAGE.splitlines() if line.startswith("| `")]
QUOTED = sorted({quote for row in ROWS for quote in re.findall(r"`([^`]+)`", row)})
# What the system says, or click.
FOREIGN = {os.strerror(number) for number in (errno.ENOSPC, errno.EFBIG, errno.EACCES, errno.ENOENT)} | {"No such file"}
NO_MESSAGES = {"OUT", ".invalid"}


def texts() -> str:
    """All strings of the program, a line each; what is filled in is ``...``."""
    found = []
    for folder in ("cli", "formats", "meshdeform", "meshdeform_core", "sample_cases"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.JoinedStr):
                    found.append("".join(str(v.value) if isinstance(v, ast.Constant) else "..." for v in node.values))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    return "\n".join(found)


ERRORS = {
    "MeshDeformError", "CaseError", "FormatError", "GridError", "MotionError", "MethodError",
    "UsageError", "BadParameter", "fail", "_fail",
}  # fmt: skip
PROGRAM = ("cli", "formats", "meshdeform", "meshdeform_core")
# What is filled in is a message itself, or a file name and a message: its words are somewhere else.
FEWEST_WORDS = 3


def pattern(quote: str) -> re.Pattern[str]:
    """What a quoted message matches; ``...`` and ``N`` are filled in."""
    return re.compile(".*".join(re.escape(part) for part in re.split(r"\.\.\.|\bN\b", quote)), re.DOTALL)


def told(node: ast.expr) -> str:
    """A message as the source gives it; what is filled in is ``...``."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(told(part) for part in node.values)
    if isinstance(node, ast.BinOp):
        return told(node.left) + told(node.right)
    return "..."


def errors_in(path: Path) -> list[str]:
    """Messages of the errors that a module raises."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    raised = [call for call in calls if (getattr(call.func, "id", "") or getattr(call.func, "attr", "")) in ERRORS]
    return [" ".join(told(argument) for argument in call.args) for call in raised]


def warnings_in(path: Path) -> list[str]:
    """Messages that functions of the core return as lists of warnings, or add to them."""
    found = []
    for function in ast.walk(ast.parse(path.read_text())):
        if isinstance(function, ast.FunctionDef) and function.returns and ast.unparse(function.returns) == "list[str]":
            lists = [node for node in ast.walk(function) if isinstance(node, ast.List)]
            added = [
                node for node in ast.walk(function) if getattr(getattr(node, "func", None), "attr", "") == "append"
            ]
            found += [told(part) for node in lists for part in node.elts] + [told(node.args[0]) for node in added]
    return found


def messages() -> list[str]:
    """Every error of the program, and the warnings of its core."""
    files = [path for folder in PROGRAM for path in (ROOT / folder).rglob("*.py")]
    core = [path for path in files if "meshdeform_core" in path.parts] + [ROOT / "cli" / "dry_run" / "forecast.py"]
    found = [text for path in files for text in errors_in(path)] + [text for path in core for text in warnings_in(path)]
    return sorted({text for text in found if len(re.findall(r"[a-zA-Z]{2,}", text)) >= FEWEST_WORDS})


def test_every_message_is_on_the_page():
    """Or says itself what it expected, as the page explains."""
    known = [pattern(quote) for quote in QUOTED if quote not in NO_MESSAGES]
    all_of_them = messages()
    assert len(all_of_them) > 350
    missing = [text for text in all_of_them if "expected" not in text and not any(p.search(text) for p in known)]
    assert missing == []


@pytest.fixture(scope="module")
def source() -> str:
    return texts()


def test_the_page_quotes_messages():
    assert len(QUOTED) > 70


@pytest.mark.parametrize("message", [quote for quote in QUOTED if quote not in FOREIGN | NO_MESSAGES])
def test_a_quoted_message_exists(message, source):
    for part in re.split(r"\.\.\.|\bN\b", message):
        # Single words between what is filled in may be filled in themselves.
        if len(part.strip()) > 3:
            assert part.strip() in source
