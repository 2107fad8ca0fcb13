"""Formulas in case files: arithmetic on coordinates and time, and nothing else.

The text is parsed into Python's syntax tree, from which this module makes the function that evaluates it. Only the
operators, functions and names listed here exist; attributes, indexing, strings, comprehensions, lambdas and assignments
are refused when the case is read, so that a case file remains pure data.
"""

from __future__ import annotations

import ast
import operator
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np

from ...errors import CaseError, suggestion
from ...wording import literal

MAX_LENGTH = 1000
_DEEPEST = 300
"""Operations within each other, each of which is two calls when the formula is evaluated."""


def _truth(value: Any) -> Any:
    """1.0 for true, 0.0 for false, NaN for neither: numbers, since numpy adds two of its truth values to one."""
    return np.where(np.isnan(value), np.nan, np.not_equal(value, 0))


def _and(*terms: Any) -> Any:
    """Three-valued: false if any is false, else NaN if any is."""
    return reduce(lambda one, two: np.where((one == 0) | (two == 0), 0.0, one * two), map(_truth, terms))


def _or(*terms: Any) -> Any:
    return _not(_and(*map(_not, terms)))


def _not(term: Any) -> Any:
    return 1.0 - _truth(term)


def _chain(comparisons: Sequence[Callable[[Any, Any], Any]], *terms: Any) -> Any:
    """``a < b <= c``, for example; NaN where either side is: numpy's comparison is false, as if it did not hold."""
    return _and(
        *(
            np.where(np.isnan(one) | np.isnan(two), np.nan, compare(one, two))
            for compare, one, two in zip(comparisons, terms, terms[1:], strict=False)
        )
    )


def _where(condition: Any, one: Any, two: Any) -> Any:
    true = _truth(condition)
    return np.where(np.isnan(true), np.nan, np.where(true == 1, one, two))


_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide, ast.Mod: np.mod,
    ast.Pow: np.power, ast.FloorDiv: np.floor_divide, ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: _not,
    ast.And: _and, ast.Or: _or,
}  # fmt: skip
_COMPARE: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal, ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}  # fmt: skip
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "where": _where, "min": np.minimum, "max": np.maximum, "atan2": np.arctan2, "hypot": np.hypot, "mod": np.mod,
    "abs": np.abs, "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "log10": np.log10, "log2": np.log2, "sin": np.sin,
    "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "sinh": np.sinh,
    "cosh": np.cosh, "tanh": np.tanh, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
    "floor": np.floor, "ceil": np.ceil, "sign": np.sign,
}  # fmt: skip
_CONSTANTS = {"pi": np.pi}
_Formula = Callable[[Mapping[str, Any]], Any]


@dataclass(frozen=True)
class Expression:
    """A formula of named variables. Raises CaseError when the text is not a formula or uses an unknown name or
    function.

    Attributes
    ----------
    text : the formula, e.g. ``0.2*sin(2*pi*(x-0.5)/L)``
    variables : the names it may use, besides the functions and ``pi``
    """

    text: str
    variables: frozenset[str]
    _tree: ast.expr = field(init=False, repr=False, compare=False)
    _evaluate: _Formula = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.text) > MAX_LENGTH:
            raise CaseError(f"expression of {len(self.text)} characters; at most {MAX_LENGTH} are allowed")
        try:
            tree = ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise CaseError(f"expression {self.text!r} is not a formula: {getattr(error, 'msg', error)}") from None
        object.__setattr__(self, "_tree", tree)
        object.__setattr__(self, "_evaluate", _evaluation(tree, self))

    def __reduce__(self) -> tuple[Any, ...]:
        # The function that evaluates it cannot be pickled, but be made again.
        return Expression, (self.text, self.variables)

    @cached_property
    def names(self) -> frozenset[str]:
        """The variables that the formula uses."""
        found = {node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)}
        return frozenset(found & self.variables)

    @property
    def is_condition(self) -> bool:
        """Whether the formula is true or false: a comparison, or several joined by ``and``, ``or``, ``not``."""
        parts = [self._tree]
        for part in parts:
            if isinstance(part, ast.BoolOp):
                parts += part.values
            elif isinstance(part, ast.UnaryOp) and isinstance(part.op, ast.Not):
                parts.append(part.operand)
            elif not isinstance(part, ast.Compare):
                return False
        return True

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Value of the formula; arrays in ``values`` broadcast. May contain NaN or inf, which the caller reports."""
        with np.errstate(all="ignore"):
            return self._evaluate(values)


def expression(source: str | float | int, variables: Iterable[str]) -> Expression:
    """Expression from a case file's number or text."""
    number = isinstance(source, int | float) and not isinstance(source, bool) and abs(source) < np.inf
    if not number and not isinstance(source, str):
        raise CaseError(f"expected a number or a formula in quotes, found {literal(source)}")
    return Expression(source if isinstance(source, str) else repr(float(source)), frozenset(variables))


def _evaluation(node: ast.AST, owner: Expression, depth: int = 0) -> _Formula:
    """The function that evaluates a part of a formula; refused is whatever is not listed here."""
    if depth > _DEEPEST:
        raise CaseError(f"expression {owner.text[:40]!r}... is nested too deeply")
    function: Callable[..., Any]
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if abs(number) > sys.float_info.max:
                raise CaseError(f"expression {owner.text[:40]!r}... holds a number beyond the range of float64")
            # Float arithmetic only: with integers 9**9**9 would never finish.
            constant = np.float64(number)
            return lambda values: constant
        case ast.Name(id=name):
            known = [*owner.variables, *_CONSTANTS]
            if name not in known:
                hint = suggestion(name, [*known, *_FUNCTIONS]) or f"; known are {', '.join(sorted(known))}"
                raise CaseError(f"expression {owner.text!r} uses the unknown name {name!r}{hint}")
            return lambda values: values[name] if name in values else _CONSTANTS[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            function, parts = _OPERATORS[type(op)], [left, right]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            function, parts = _OPERATORS[type(op)], [operand]
        case ast.BoolOp(op=op, values=parts):
            function = _OPERATORS[type(op)]
        case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARE for op in ops):
            function, parts = partial(_chain, [_COMPARE[type(op)] for op in ops]), [left, *others]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name not in _FUNCTIONS:
                hint = suggestion(name, _FUNCTIONS) or f"; known are {', '.join(sorted(_FUNCTIONS))}"
                raise CaseError(f"expression {owner.text!r} calls the unknown function {name!r}{hint}")
            function, parts = _FUNCTIONS[name], args
            if len(args) != (expected := getattr(function, "nin", 3)):
                raise CaseError(f"expression {owner.text!r}: {name} takes {expected} arguments, found {len(args)}")
        case _:
            piece = ast.get_source_segment(owner.text.strip(), node) if isinstance(node, ast.expr) else None
            hint = "; powers are written **" if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitXor) else ""
            raise CaseError(
                f"expression {owner.text!r}: {piece or type(node).__name__!r} is not allowed; "
                f"only arithmetic, comparison, and/or/not, the elementary functions and pi are{hint}"
            )
    terms = [_evaluation(part, owner, depth + 1) for part in parts]
    return lambda values: function(*(term(values) for term in terms))
