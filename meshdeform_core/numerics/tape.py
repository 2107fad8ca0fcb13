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
        return self.tape.result(self.value.T, [(self, np.transpose, np.transpose)])

    def __len__(self) -> int:
        return len(self.value)

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a tracked array would lose its derivative here")

    def copy(self) -> Tracked:
        """A copy with the same value."""
        return Tracked(self.value.copy(), self.tape, self.number)

    def reshape(self, *shape: Any) -> Tracked:
        """Another shape of the same values."""
        new = self.value.reshape(*shape)
        return (
            self.tape.result(new, [(self, lambda t: t.reshape(new.shape), lambda g: g.reshape(self_shape))])
            if (self_shape := self.shape) != new.shape
            else self
        )

    def sum(self, axis: int | None = None, keepdims: bool = False) -> Tracked:
        """Sum along an axis."""
        shape = self.shape

        def spread(g: FloatArray) -> FloatArray:
            return np.broadcast_to(g if axis is None or keepdims else np.expand_dims(g, axis), shape)

        return self.tape.result(
            self.value.sum(axis=axis, keepdims=keepdims),
            [(self, lambda t: t.sum(axis=axis, keepdims=keepdims), spread)],
        )

    def max(self) -> Tracked:
        """The largest value of a one-dimensional array; of several largest ones with the mean of their derivatives."""
        rows = largest(self.value)
        return self[rows].sum() * (1.0 / len(rows))

    def any(self, *args: Any, **options: Any) -> Any:
        """Whether any value is nonzero; not recorded."""
        return self.value.any(*args, **options)

    def __getitem__(self, place: Any) -> Tracked:
        shape, once = self.shape, isinstance(place, int | slice)

        def pull(g: FloatArray) -> FloatArray:
            total = np.zeros(shape)
            if once:
                total[place] = g
            else:
                np.add.at(total, place, g)
            return total

        return self.tape.result(self.value[place], [(self, lambda t: t[place], pull)])

    def __setitem__(self, place: Any, new: Any) -> None:
        before = Tracked(self.value, self.tape, self.number)
        value = self.value.copy()
        value[place] = plain(new)

        def cleared(t: FloatArray) -> FloatArray:
            t = np.array(t)
            t[place] = 0.0
            return t

        links: list[Link] = [(before, cleared, cleared)]
        if isinstance(new, Tracked):
            shape = new.shape

            def put(t: FloatArray) -> FloatArray:
                total = np.zeros(value.shape)
                total[place] = t
                return total

            links.append((new, put, lambda g: _reduced(g[place], shape)))
        self._become(self.tape.result(value, links))

    def _become(self, other: Tracked) -> None:
        self.value, self.number = other.value, other.number

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__":
            return NotImplemented
        values = [plain(each) for each in inputs]
        if ufunc.__name__ in _FIXED:
            return ufunc(*values)
        if ufunc is np.matmul:
            return _products(np.matmul, _MATMUL[values[0].ndim, values[1].ndim], inputs)
        out, mask = options.get("out", (None,))[0], options.get("where", True)
        # Where the mask is false, the result is ``out``, which must not be a tracked array.
        value = ufunc(*values) if mask is True else ufunc(*values, out=plain(out).copy(), where=mask)
        with np.errstate(all="ignore"):
            partials = _PARTIALS[ufunc.__name__](value, *values)
        links = []
        for each, partial in zip(inputs, partials, strict=True):
            if isinstance(each, Tracked):
                factor = partial if mask is True else np.where(mask, partial, 0.0)
                links.append(_scaled(each, factor, np.shape(value)))
        found = self.tape.result(value, links)
        if isinstance(out, Tracked):
            out._become(found)
            return out
        return found

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


def _reduced(gradient: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """The transpose of broadcasting an array of ``shape``."""
    while gradient.ndim > len(shape):
        gradient = gradient.sum(axis=0)
    wide = tuple(n for n, size in enumerate(shape) if size == 1 and gradient.shape[n] != 1)
    return gradient.sum(axis=wide, keepdims=True) if wide else gradient


def _scaled(source: Tracked, factor: Any, shape: tuple[int, ...]) -> Link:
    """Link of an elementwise operation with partial derivative ``factor``."""
    own = source.shape
    return source, lambda t: np.broadcast_to(factor * t, shape), lambda g: _reduced(np.asarray(factor * g), own)


def _tape_of(values: Any) -> Tape:
    return next(each.tape for each in values if isinstance(each, Tracked))


def _products(function: Callable[..., Any], rule: str, operands: Any) -> Tracked:
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
    links = [_scaled(each, factor, value.shape) for each, factor in chosen if isinstance(each, Tracked)]
    return _tape_of((yes, no)).result(value, links)


def _joined(join: Callable[..., Any], parts: Any, axis: int) -> Tracked:
    value = join([plain(each) for each in parts], axis=axis)
    links: list[Link] = []
    for n, each in enumerate(parts):
        if isinstance(each, Tracked):
            # Where the entries of operand n end up in the result.
            shapes = [np.shape(plain(part)) for part in parts]
            places = join([np.full(shape, m == n) for m, shape in enumerate(shapes)], axis=axis)
            order = join([np.arange(math.prod(shape)).reshape(shape) for shape in shapes], axis=axis)[places]

            def push(t: FloatArray, places: Any = places, order: Any = order) -> FloatArray:
                total = np.zeros(places.shape)
                total[places] = np.asarray(t).ravel()[order]
                return total

            def pull(g: FloatArray, places: Any = places, order: Any = order, shape: Any = each.shape) -> FloatArray:
                total = np.empty(math.prod(shape))
                total[order] = g[places]
                return total.reshape(shape)

            links.append((each, push, pull))
    return _tape_of(parts).result(value, links)


def _cross(a: Any, b: Any) -> Tracked:
    x, y = plain(a), plain(b)
    value = np.cross(x, y)
    links: list[Link] = []
    if isinstance(a, Tracked):
        links.append((a, lambda t: np.cross(t, y), lambda g: _reduced(np.cross(y, g), x.shape)))
    if isinstance(b, Tracked):
        links.append((b, lambda t: np.cross(x, t), lambda g: _reduced(np.cross(g, x), y.shape)))
    return _tape_of((a, b)).result(value, links)


def _bincount(places: Any, weights: Tracked, minlength: int = 0) -> Tracked:
    value = np.bincount(places, weights.value, minlength)
    return weights.tape.result(
        value, [(weights, lambda t: np.bincount(places, t, minlength).astype(np.float64), lambda g: g[places])]
    )


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.einsum: lambda rule, *operands: _products(np.einsum, rule, operands),
    np.where: _where,
    np.concatenate: lambda parts, axis=0: _joined(np.concatenate, parts, axis),
    np.stack: lambda parts, axis=0: _joined(np.stack, parts, axis),
    np.cross: _cross,
    np.bincount: _bincount,
    np.linalg.norm: lambda x, axis=None, keepdims=False: np.sqrt((x * x).sum(axis=axis, keepdims=keepdims)),
    np.zeros_like: lambda x: x.tape.result(np.zeros(x.shape), []),
}
