"""Advice on warnings finds the warnings that it is for."""

import ast
import functools
from pathlib import Path

import pytest

import meshdeform_core
from meshdeform_formats.report.tables import REMEDIES, remedy_of


@functools.cache
def texts_of_the_core() -> list[str]:
    """All string literals of the core, the values in formatted ones left out."""
    found = []
    for path in Path(meshdeform_core.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            found.append("".join(p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)))
    return found


@pytest.mark.parametrize(("words", "advice"), REMEDIES)
def test_some_warning_contains_the_words(words, advice):
    assert any(words in text and remedy_of(text) == advice for text in texts_of_the_core())


def test_other_warnings_have_no_advice():
    assert remedy_of("walls turn by up to 70 degrees") == ""
