"""Formulas: what they compute, and that nothing else can be said in them."""

import pickle
import re

import numpy as np
import pytest

from meshdeform_core.boundary.motions.expression import MAX_LENGTH, expression
from meshdeform_core.errors import CaseError

X = np.linspace(-1.0, 2.0, 7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.2*sin(2*pi*(x-0.5)/L)", 0.2 * np.sin(2 * np.pi * (X - 0.5) / 5)),
        ("x > 0.5 and abs(x) < 1.6", (X > 0.5) & (np.abs(X) < 1.6)),
        ("not x > 0 or x >= 2", ~(X > 0) | (X >= 2)),
        ("-1 < x <= 1 != 2", (X > -1) & (X <= 1)),
        ("(x > -3) + (x > 0) - (x > 1)", 1.0 + (X > 0) - 1.0 * (X > 1)),
        ("sin(x > -3) + exp(not x < -3)", np.full(7, np.sin(1.0) + np.e)),
        ("-(x > 0) + sign(x > 0) + (+(x > 0))", 1.0 * (X > 0)),
        ("-(x > 0)", -1.0 * (X > 0)),
        ("hypot(x > 0, x > 0)", np.sqrt(2.0) * (X > 0)),
        ("where(x > 0, x**2, -x)", np.where(X > 0, X**2, -X)),
        ("max(0, 1 - abs(x)) + min(x, 0)", np.maximum(0, 1 - np.abs(X)) + np.minimum(X, 0)),
        ("atan2(x, 2) + hypot(x, 1) + mod(x, 0.7)", np.arctan2(X, 2) + np.hypot(X, 1) + np.mod(X, 0.7)),
        ("x // 1 + x % 1", X),
        ("1/2", 0.5),
    ],
)
def test_values(text, expected):
    formula = expression(text, {"x", "L"})
    np.testing.assert_allclose(formula({"x": X, "L": 5.0}), expected, atol=1e-15)
    assert formula.is_condition == (np.asarray(expected).dtype == bool)
    assert formula.names == {name for name in ("x", "L") if re.search(rf"\b{name}\b", text)}


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')", "x.__class__", "x[0]", "(lambda: 1)()", "[i for i in x]", "{x}", "(x, x)", "'text'", "True",
        "f'{x}'", "x := 2", "x if x else 2", "1j", "sin(x=1)", "sin(*x)", "open", "eval(x)", "exec", "x @ x", "x ^ 2",
        "x << 2", "~x", "x is x", "x in x", "None", "...", "b'0'", "await x", "x;x", "import os", "", "   ", "x\nx",
        "sin()", "sin(x, x)", "where(x)", "u", "1e", "0x", "x" + "+x" * 499, "(" * 300 + "x" + ")" * 300, "9" * 400,
        "x" * (MAX_LENGTH + 1), "getattr(x, 'y')", "pi()", "x(1)", "globals()", "print(x)", True, None, [1], {"a": 1},
    ],
)  # fmt: skip
def test_nothing_else_is_a_formula(text):
    with pytest.raises(CaseError):
        expression(text, {"x"})


def test_numbers_are_floats_so_that_powers_end_also_in_pickles():
    assert pickle.loads(pickle.dumps(expression("9**9**9**9", ())))({}) == np.inf
    assert np.isnan(expression("0/0", ())({}))
    assert not expression("1 > 0 and 2", ()).is_condition


def test_hints():
    with pytest.raises(CaseError, match="did you mean 'sin'"):
        expression("sni(x)", {"x"})
    with pytest.raises(CaseError, match="did you mean 'length'"):
        expression("lenght*2", {"length"})
    with pytest.raises(CaseError, match=r"expected a number or a formula in quotes, found \[1\]$"):
        expression([1], ())
    with pytest.raises(CaseError, match=r"powers are written \*\*"):
        expression("x^2", {"x"})


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("nan < 1", None), ("nan and 0", False), ("0 and nan", False), ("nan and 1", None), ("nan or 1", True),
        ("1 or nan", True), ("nan or 0", None), ("not nan", None), ("0 < 1 < nan", None), ("1 < 0 < nan", False),
        ("where(nan, 1, 2)", None), ("where(0 < 1, 1, nan)", True), ("nan == nan", None), ("nan", None),
    ],
)  # fmt: skip
def test_what_is_not_a_number_is_neither_true_nor_false(formula, expected):
    value = expression(formula.replace("nan", "v"), {"v"})({"v": np.array([np.nan, np.nan])})
    value = np.broadcast_to(value, 2)
    if expected is None:
        assert np.isnan(value).all()
    else:
        assert (value.astype(bool) == expected).all()
        assert not np.isnan(value).any()
