"""Derivatives of numpy code by recording it: forward and transposed from the same local derivatives.

Code runs unchanged with :class:`Tracked` arrays instead of plain ones, and every operation records its derivative.
Whatever the code decides by comparison (branches, masks, numbers of turns) is held fixed. Square roots and arc tangents
at zero get a derivative of zero: code that is smooth there must not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from .arrays import FloatArray, IntArray

Linear = Callable[[FloatArray], FloatArray]
Link = tuple["Tracked", Linear, Linear]


_TIED = 1e-10
"""Relative difference of values that count as equal."""
_FIXED = ("less", "greater", "equal", "not_equal", "rint", "sign")
"""Functions with zero derivative almost everywhere."""
_PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda y, a, b: (1.0, 1.0),
    "subtract": lambda y, a, b: (1.0, -1.0),
    "multiply": lambda y, a, b: (b, a),
    "divide": lambda y, a, b: (1.0 / np.asarray(b), -np.asarray(a) / np.asarray(b) ** 2),
    "negative": lambda y, a: (-1.0,),
    "sqrt": lambda y, a: (_quotient(0.5, y),),
    "hypot": lambda y, a, b: (_quotient(a, y), _quotient(b, y)),
    "exp": lambda y, a: (y,),
    "log": lambda y, a: (1.0 / a,),
    "sin": lambda y, a: (np.cos(a),),
    "cos": lambda y, a: (-np.sin(a),),
    "power": lambda y, a, n: (n * a ** (n - 1.0), 0.0),
    "arctan2": lambda y, a, b: (_quotient(b, a**2 + b**2), -_quotient(a, a**2 + b**2)),
    "maximum": lambda y, a, b: ((np.asarray(a) >= b) * 1.0, (np.asarray(a) < b) * 1.0),
}
"""Partial derivatives of numpy's elementwise functions with the result y."""
_MATMUL = {(1, 1): "i,i->", (1, 2): "i,ij->j", (2, 1): "ij,j->i", (2, 2): "ij,jk->ik"}
"""Rule of ``einsum`` for products of matrices and vectors, by the numbers of dimensions of the two operands."""


class Tape:
    """The operations on tracked arrays, in order."""

    def __init__(self) -> None:
        self._shapes: list[tuple[int, ...]] = []
        self._steps: list[tuple[int, list[tuple[int, Linear, Linear]]]] = []

    def variable(self, value: FloatArray) -> Tracked:
        """A tracked array with this value, with respect to which derivatives can be taken."""
        return Tracked(np.array(value, dtype=np.float64), self, self._new(value.shape))

    def result(self, value: Any, links: list[Link]) -> Tracked:
        """A tracked array whose change is the sum over its ``links``: source, linear map of its change, transpose."""
        value = np.asarray(value, dtype=np.float64)
        number = self._new(value.shape)
        self._steps.append((number, [(source.number, push, pull) for source, push, pull in links]))
        return Tracked(value, self, number)

    def _new(self, shape: tuple[int, ...]) -> int:
        self._shapes.append(tuple(shape))
        return len(self._shapes) - 1

    def push(self, changes: dict[int, FloatArray], wanted: list[int]) -> list[FloatArray]:
        """Changes of the arrays with the numbers ``wanted``, for ``changes`` of variables (by number)."""
        known = dict(changes)
        last = {source: place for place, (_, links) in enumerate(self._steps) for source, _, _ in links}
        for place, (number, links) in enumerate(self._steps):
            parts = [push(known[source]) for source, push, _ in links if source in known]
            if parts:
                known[number] = sum(parts[1:], parts[0])
            for source, _, _ in links:
                # Changes that no later operation needs are freed.
                if last[source] == place and source not in wanted:
                    known.pop(source, None)
        return [known.get(number, np.zeros(self._shapes[number])) for number in wanted]

    def pull(self, gradients: dict[int, FloatArray], variables: list[int]) -> list[FloatArray]:
        """Gradients with respect to variables from those with respect to results: the transpose of :meth:`push`."""
        known = dict(gradients)
        for number, links in reversed(self._steps):
            if number in known:
                given = known.pop(number)
                for source, _, pull in links:
                    part = pull(given)
                    known[source] = known[source] + part if source in known else part
        return [known.get(number, np.zeros(self._shapes[number])) for number in variables]


class Tracked(NDArrayOperatorsMixin):
    """An array whose operations are recorded; ``value`` is its content, ``number`` its position on the tape."""

    def __init__(self, value: FloatArray, tape: Tape, number: int) -> None:
        self.value, self.tape, self.number = value, tape, number

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    @property
    def ndim(self) -> int:
        return self.value.ndim

    @property
    def size(self) -> int:
        return self.value.size

    @property
    def T(self) -> Tracked:
        return self._gathered(np.transpose)

    def __len__(self) -> int:
        return len(self.value)

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a tracked array would lose its derivative here")

    def copy(self) -> Tracked:
        """The same: tracked arrays do not change."""
        return self

    def reshape(self, *shape: Any) -> Tracked:
        """Another shape of the same values."""
        return self._gathered(lambda values: values.reshape(*shape))

    def sum(self, axis: int | None = None, keepdims: bool = False) -> Tracked:
        """Sum along an axis."""
        value = self.value.sum(axis=axis, keepdims=True)
        to, found = np.broadcast_to(_numbers(value.shape), self.shape), value if keepdims else value.squeeze(axis)
        return self.tape.result(found, [_terms(self, found.shape, to=to)])

    def max(self) -> Tracked:
        """The largest value of a one-dimensional array; of several largest ones with the mean of their derivatives."""
        rows = largest(self.value)
        return self[rows].sum() * (1.0 / len(rows))

    def any(self, *args: Any, **options: Any) -> Any:
        """Whether any value is nonzero; not recorded."""
        return self.value.any(*args, **options)

    def __getitem__(self, place: Any) -> Tracked:
        return self._gathered(lambda values: values[place])

    def _gathered(self, gather: Callable[[Any], Any]) -> Tracked:
        """What an operation gives that only moves and copies values."""
        value = gather(self.value)
        return self.tape.result(value, [_terms(self, np.shape(value), of=gather(_numbers(self.shape)))])

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            return NotImplemented
        values = [plain(each) for each in inputs]
        if ufunc.__name__ in _FIXED:
            return ufunc(*values)
        if ufunc is np.matmul:
            return _products(_MATMUL[values[0].ndim, values[1].ndim], *inputs)
        value = ufunc(*values)
        with np.errstate(all="ignore"):
            partials = _PARTIALS[ufunc.__name__](value, *values)
        links = [
            _spread(each, np.shape(value), partial)
            for each, partial in zip(inputs, partials, strict=True)
            if isinstance(each, Tracked)
        ]
        return self.tape.result(value, links)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        if function not in _FUNCTIONS:
            raise TypeError(f"no derivative of numpy's {function.__name__} is known")
        return _FUNCTIONS[function](*args, **options)


def largest(values: FloatArray) -> IntArray:
    """Places of the largest of some values, none of them negative, and of all that are equal but for round-off."""
    return np.flatnonzero(values >= (1.0 - _TIED) * values.max())


def plain(value: Any) -> Any:
    """The value of a tracked array; anything else is returned unchanged."""
    return value.value if isinstance(value, Tracked) else value


def _quotient(a: Any, b: Any) -> Any:
    """a / b, zero where b is."""
    b = np.asarray(b)
    return np.where(b != 0.0, a / np.where(b != 0.0, b, 1.0), 0.0)


def _numbers(shape: tuple[int, ...]) -> IntArray:
    """The numbers of the elements of an array, in its shape."""
    return np.arange(math.prod(shape)).reshape(shape)


def _terms(
    source: Tracked, shape: tuple[int, ...], factor: Any = 1.0, of: IntArray | None = None, to: IntArray | None = None
) -> Link:
    """Link to a result of this ``shape`` that is a sum of terms: a factor times the elements ``of`` the source, by
    number, added ``to`` those of the result; by default one term for each element, in order."""
    own = source.shape
    return source, lambda t: _added(t, factor, of, to, shape), lambda g: _added(g, factor, to, of, own)


def _added(
    values: FloatArray, factor: Any, of: IntArray | None, to: IntArray | None, shape: tuple[int, ...]
) -> FloatArray:
    terms = factor * (values if of is None else values.ravel()[of])
    if to is not None:
        terms = np.bincount(to.ravel(), np.broadcast_to(terms, to.shape).ravel(), math.prod(shape))
    return np.asarray(terms).reshape(shape)


def _spread(source: Tracked, shape: tuple[int, ...], factor: Any) -> Link:
    """Link of an elementwise operation with partial derivative ``factor``, for which the source is broadcast."""
    return _terms(
        source, shape, factor, None if source.shape == shape else np.broadcast_to(_numbers(source.shape), shape)
    )


def _tape_of(values: Any) -> Tape:
    return next(each.tape for each in values if isinstance(each, Tracked))


def _products(rule: str, *operands: Any) -> Tracked:
    """A sum of products by an ``einsum`` rule; every index of an operand occurs in another operand or in the result."""
    values = [plain(each) for each in operands]
    inputs, result = rule.split("->")
    names = inputs.split(",")
    links: list[Link] = []
    for n, each in enumerate(operands):
        if isinstance(each, Tracked):
            others = values[:n], values[n + 1 :]
            back = ",".join([result, *names[:n], *names[n + 1 :]]) + "->" + names[n]

            def push(t: FloatArray, others: Any = others) -> FloatArray:
                return np.asarray(np.einsum(rule, *others[0], t, *others[1]))

            def pull(g: FloatArray, others: Any = others, back: str = back) -> FloatArray:
                return np.asarray(np.einsum(back, g, *others[0], *others[1]))

            links.append((each, push, pull))
    return _tape_of(operands).result(np.einsum(rule, *values), links)


def _where(mask: Any, yes: Any, no: Any) -> Tracked:
    mask = plain(mask)
    value = np.where(mask, plain(yes), plain(no))
    chosen = ((yes, np.where(mask, 1.0, 0.0)), (no, np.where(mask, 0.0, 1.0)))
    links = [_spread(each, value.shape, factor) for each, factor in chosen if isinstance(each, Tracked)]
    return _tape_of((yes, no)).result(value, links)


def _joined(join: Callable[..., Any], parts: Any, axis: int) -> Tracked:
    values = [np.asarray(plain(each)) for each in parts]
    value, ends = join(values, axis=axis), np.cumsum([0, *(each.size for each in values)])
    # Where in all operands, one after the other, the elements of the result come from.
    numbers = join([_numbers(each.shape) + first for each, first in zip(values, ends, strict=False)], axis=axis).ravel()
    links: list[Link] = []
    for each, first, last in zip(parts, ends, ends[1:], strict=False):
        if isinstance(each, Tracked):
            to = np.flatnonzero((numbers >= first) & (numbers < last))
            links.append(_terms(each, value.shape, of=numbers[to] - first, to=to))
    return _tape_of(parts).result(value, links)


def _bincount(places: Any, weights: Tracked, minlength: int = 0) -> Tracked:
    value = np.bincount(places, weights.value, minlength)
    return weights.tape.result(value, [_terms(weights, value.shape, to=places)])


_PERMUTATIONS = np.array([[[(i - j) * (j - k) * (k - i) / 2.0 for k in range(3)] for j in range(3)] for i in range(3)])
"""The sign of every permutation i, j, k of 0, 1, 2, and zero: the cross product is sum a_i b_j sign_ijk."""


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.einsum: _products,
    np.where: _where,
    np.concatenate: lambda parts, axis=0: _joined(np.concatenate, parts, axis),
    np.stack: lambda parts, axis=0: _joined(np.stack, parts, axis),
    np.cross: lambda a, b: _products(f"{'ni'[-a.ndim :]},{'nj'[-b.ndim :]},ijk->nk", a, b, _PERMUTATIONS),
    np.bincount: _bincount,
    np.linalg.norm: lambda x, axis=None, keepdims=False: np.sqrt((x * x).sum(axis=axis, keepdims=keepdims)),
}
