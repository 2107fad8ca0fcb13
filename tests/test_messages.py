"""Messages that the pages quote are messages that the program gives."""

from __future__ import annotations

import ast
import errno
import os
import re
from pathlib import Path

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


def test_messages_that_the_page_quotes_exist():
    assert len(QUOTED) > 30
    source = texts()
    quoted = [quote for quote in QUOTED if quote not in FOREIGN | NO_MESSAGES]
    parts = [(quote, part.strip()) for quote in quoted for part in re.split(r"\.\.\.|\bN\b", quote)]
    # Single words between what is filled in may be filled in themselves.
    assert [quote for quote, part in parts if len(part) > 3 and part not in source] == []
