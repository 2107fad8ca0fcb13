"""Formulas in case files: arithmetic on coordinates and time, and nothing else.

The text is parsed into Python's syntax tree, which is evaluated by this module. Only the operators, functions and names
listed here exist; attributes, indexing, strings, comprehensions, lambdas and assignments are refused when the case is
read, so that a case file remains pure data.
"""

from __future__ import annotations

import ast
import operator
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import CaseError, suggestion
from ...wording import literal

MAX_LENGTH = 1000
_DEEPEST = 400
"""Operations within each other, each of which is a call when the formula is evaluated."""


def _truth(value: Any) -> tuple[Any, Any]:
    """Where a value is true, and where it is undefined (NaN)."""
    unknown = np.isnan(value)
    return np.not_equal(value, 0) & ~unknown, unknown


def _with_unknown(true: Any, unknown: Any) -> Any:
    """1.0 and 0.0 for true and false, NaN for neither: numbers, since numpy adds two of its truth values to one."""
    return np.where(unknown, np.nan, true)


def _and(one: Any, two: Any) -> Any:
    """Three-valued: false if either is false, else NaN if either is."""
    (a, unknown_a), (b, unknown_b) = _truth(one), _truth(two)
    return _with_unknown(a & b, (unknown_a & (b | unknown_b)) | (unknown_b & (a | unknown_a)))


def _not(one: Any) -> Any:
    true, unknown = _truth(one)
    return _with_unknown(~true, unknown)


def _or(one: Any, two: Any) -> Any:
    return _not(_and(_not(one), _not(two)))


def _where(condition: Any, one: Any, two: Any) -> Any:
    true, unknown = _truth(condition)
    return np.where(unknown, np.nan, np.where(true, one, two))


def _comparison(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The comparison, NaN where either side is: numpy's is false, as if the condition did not hold."""
    return lambda one, two: _with_unknown(compare(one, two), np.isnan(one) | np.isnan(two))


_BINARY: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.FloorDiv: np.floor_divide,
}
_COMPARE: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Lt: _comparison(operator.lt),
    ast.LtE: _comparison(operator.le),
    ast.Gt: _comparison(operator.gt),
    ast.GtE: _comparison(operator.ge),
    ast.Eq: _comparison(operator.eq),
    ast.NotEq: _comparison(operator.ne),
}
_UNARY: dict[type[ast.AST], Callable[[Any], Any]] = {ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: _not}
_FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "where": (3, _where),
    "min": (2, np.minimum),
    "max": (2, np.maximum),
    "atan2": (2, np.arctan2),
    "hypot": (2, np.hypot),
    "mod": (2, np.mod),
    **{
        name: (1, function)
        for name, function in {
            "abs": np.abs, "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "log10": np.log10, "log2": np.log2,
            "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
            "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "asinh": np.arcsinh, "acosh": np.arccosh,
            "atanh": np.arctanh, "floor": np.floor, "ceil": np.ceil, "sign": np.sign,
        }.items()
    },
}  # fmt: skip
_CONSTANTS = {"pi": np.pi}


@dataclass(frozen=True)
class Expression:
    """A formula of named variables.

    Attributes
    ----------
    text : the formula, e.g. ``0.2*sin(2*pi*(x-0.5)/L)``
    variables : the names it may use, besides the functions and ``pi``

    Raises
    ------
    CaseError
        When the text is not a formula or uses an unknown name or function.
    """

    text: str
    variables: frozenset[str]

    def __post_init__(self) -> None:
        _check(self._tree, self)

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > MAX_LENGTH:
            raise CaseError(f"expression of {len(self.text)} characters; at most {MAX_LENGTH} are allowed")
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise CaseError(f"expression {self.text!r} is not a formula: {getattr(error, 'msg', error)}") from None

    @cached_property
    def names(self) -> frozenset[str]:
        """The variables that the formula uses."""
        found = {node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)}
        return frozenset(found & self.variables)

    @property
    def is_condition(self) -> bool:
        """Whether the formula is true or false: a comparison, or several joined by ``and``, ``or``, ``not``."""
        return _is_condition(self._tree)

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Value of the formula; arrays in ``values`` broadcast. May contain NaN or inf, which the caller reports."""
        with np.errstate(all="ignore"):
            return _value(self._tree, values)


def expression(source: str | float | int, variables: Iterable[str]) -> Expression:
    """Expression from a case file's number or text."""
    number = isinstance(source, int | float) and not isinstance(source, bool) and abs(source) < np.inf
    if not number and not isinstance(source, str):
        raise CaseError(f"expected a number or a formula in quotes, found {literal(source)}")
    return Expression(source if isinstance(source, str) else repr(float(source)), frozenset(variables))


def _is_condition(node: ast.AST) -> bool:
    match node:
        case ast.Compare():
            return True
        case ast.BoolOp(values=values):
            return all(map(_is_condition, values))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return _is_condition(operand)
    return False


def _check(node: ast.AST, owner: Expression, depth: int = 0) -> None:
    if depth > _DEEPEST:
        raise CaseError(f"expression {owner.text[:40]!r}... is nested too deeply")
    parts = list[ast.expr]()
    match node:
        case ast.Constant(value=bool()):
            _refuse(node, owner)
        case ast.Constant(value=int() | float() as number):
            if abs(number) > sys.float_info.max:
                raise CaseError(f"expression {owner.text[:40]!r}... holds a number beyond the range of float64")
        case ast.Name(id=name):
            known = [*owner.variables, *_CONSTANTS]
            if name not in known:
                hint = suggestion(name, [*known, *_FUNCTIONS]) or f"; known are {', '.join(sorted(known))}"
                raise CaseError(f"expression {owner.text!r} uses the unknown name {name!r}{hint}")
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            parts = [left, right]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            parts = [operand]
        case ast.BoolOp(values=values):
            parts = values
        case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARE for op in ops):
            parts = [left, *others]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name not in _FUNCTIONS:
                hint = suggestion(name, _FUNCTIONS) or f"; known are {', '.join(sorted(_FUNCTIONS))}"
                raise CaseError(f"expression {owner.text!r} calls the unknown function {name!r}{hint}")
            expected = _FUNCTIONS[name][0]
            if len(args) != expected:
                raise CaseError(f"expression {owner.text!r}: {name} takes {expected} arguments, found {len(args)}")
            parts = args
        case _:
            _refuse(node, owner)
    for part in parts:
        _check(part, owner, depth + 1)


def _refuse(node: ast.AST, owner: Expression) -> None:
    piece = ast.get_source_segment(owner.text.strip(), node) if isinstance(node, ast.expr) else None
    hint = "; powers are written **" if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitXor) else ""
    raise CaseError(
        f"expression {owner.text!r}: {piece or type(node).__name__!r} is not allowed; "
        f"only arithmetic, comparison, and/or/not, the elementary functions and pi are{hint}"
    )


def _value(node: ast.AST, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=int() | float() as value):
            # Float arithmetic only: with integers 9**9**9 would never finish.
            return np.float64(value)
        case ast.Name(id=name):
            return values[name] if name in values else _CONSTANTS[name]
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_value(left, values), _value(right, values))
        case ast.UnaryOp(op=op, operand=operand):
            return _UNARY[type(op)](_value(operand, values))
        case ast.BoolOp(op=op, values=parts):
            combine = _and if isinstance(op, ast.And) else _or
            result = _value(parts[0], values)
            for part in parts[1:]:
                result = combine(result, _value(part, values))
            return result
        case ast.Compare(left=left, ops=ops, comparators=others):
            terms = [_value(term, values) for term in (left, *others)]
            result = _COMPARE[type(ops[0])](terms[0], terms[1])
            for compare, one, two in zip(ops[1:], terms[1:], terms[2:], strict=False):
                result = _and(result, _COMPARE[type(compare)](one, two))
            return result
        case ast.Call(func=ast.Name(id=name), args=args):
            return _FUNCTIONS[name][1](*(_value(arg, values) for arg in args))
    raise AssertionError(f"unchecked node {node!r}")
