"""Algebras of Taylor coefficients: balls, or jets of balls by the product rule and the chain rule.

None is a zero that follows from the structure (what does not depend on a variable, or on time); most entries are such
zeros, and cost nothing. Coefficients 0 are never None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, Protocol, TypeAlias

from flint import arb

from . import ranges

Jet: TypeAlias = list[Any]
"""Value, gradient (v entries), upper triangle of the Hessian row by row (v (v + 1)/2 entries), cut after the order."""


class Algebra(Protocol):
    """What the recurrences need of coefficients."""

    def variable(self, value: Any, number: int | None) -> Any:
        """A coefficient 0 of this value: the variable of this number, or a constant."""

    def add(self, a: Any, b: Any) -> Any:
        """a + b."""

    def subtract(self, a: Any, b: Any) -> Any:
        """a - b."""

    def scale(self, a: Any, factor: Any) -> Any:
        """a times a ball or a whole number."""

    def convolve(self, left: Iterable[Any], right: Iterable[Any]) -> Any:
        """Sum of the products of pairs."""

    def square(self, a: Any) -> Any:
        """Square of a coefficient 0; its value is the tight one."""

    def function(self, name: str, a: Any) -> Any:
        """An elementary function of a coefficient 0."""

    def sincos(self, a: Any) -> tuple[Any, Any]:
        """Sine and cosine of a coefficient 0."""

    def value(self, a: Any) -> Any:
        """Value of a coefficient 0."""

    def jet(self, a: Any) -> Jet:
        """A coefficient with its zeros written out."""


@lru_cache(maxsize=64)
def algebra_of(order: int, dimension: int) -> Algebra:
    """The algebra for jets of order 0, 1 or 2 in `dimension` variables."""
    if order not in (0, 1, 2):
        raise AssertionError(f"jets have order 0, 1 or 2, not {order}")
    return _Jets(order, dimension) if order else _Values()


class _Values:
    """Algebra of order 0: a coefficient is a ball, or None."""

    def variable(self, value: Any, number: int | None) -> Any:
        return value

    def add(self, a: Any, b: Any) -> Any:
        return _plus(a, b)

    def subtract(self, a: Any, b: Any) -> Any:
        return _minus(a, b)

    def scale(self, a: Any, factor: Any) -> Any:
        return None if a is None else a * factor

    def convolve(self, left: Iterable[Any], right: Iterable[Any]) -> Any:
        total = None
        for x, y in zip(left, right, strict=True):
            if x is not None and y is not None:
                total = x * y if total is None else total + x * y
        return total

    def square(self, a: Any) -> Any:
        return ranges.square(a)

    def function(self, name: str, a: Any) -> Any:
        return getattr(ranges, name)(a)

    def sincos(self, a: Any) -> tuple[Any, Any]:
        return ranges.sincos(a)

    def value(self, a: Any) -> Any:
        return a

    def jet(self, a: Any) -> Jet:
        return [arb(0) if a is None else a]


class _Jets:
    """Algebra of orders 1 and 2 in v variables: a coefficient is a list of balls and Nones, or None."""

    def __init__(self, order: int, dimension: int) -> None:
        pairs = [(i, j) for i in range(dimension) for j in range(i, dimension)] if order == 2 else []
        self.gradient = range(1, 1 + dimension)
        self.hessian = [(1 + dimension + h, 1 + i, 1 + j) for h, (i, j) in enumerate(pairs)]
        """Entry, and the entries of the gradient that belong to its row and its column."""
        self.size = 1 + dimension + len(pairs)
        # entry l of the left factor times entry r of the right one is a part of entry c of the product
        self.partners: list[list[tuple[int, int]]] = [[(c, c) for c in range(self.size)]]
        self.partners += [[(0, c)] for c in range(1, self.size)]
        for c, i, j in self.hessian:
            self.partners[i].append((j, c))
            self.partners[j].append((i, c))

    def variable(self, value: Any, number: int | None) -> Any:
        return [value, *(arb(1) if entry - 1 == number else None for entry in self.gradient)] + [None] * len(
            self.hessian
        )

    def add(self, a: Any, b: Any) -> Any:
        if a is None or b is None:
            return _plus(a, b)
        return [_plus(x, y) for x, y in zip(a, b, strict=True)]

    def subtract(self, a: Any, b: Any) -> Any:
        if b is None:
            return a
        return [_minus(x, y) for x, y in zip([None] * self.size if a is None else a, b, strict=True)]

    def scale(self, a: Any, factor: Any) -> Any:
        return None if a is None else [None if x is None else x * factor for x in a]

    def convolve(self, left: Iterable[Any], right: Iterable[Any]) -> Any:
        total: Jet | None = None
        for a, b in zip(left, right, strict=True):
            if a is None or b is None:
                continue
            if total is None:
                total = [None] * self.size
            for x, partners in zip(a, self.partners, strict=True):
                if x is None:
                    continue
                for position, entry in partners:
                    y = b[position]
                    if y is not None:
                        before = total[entry]
                        total[entry] = x * y if before is None else before + x * y
        return total

    def square(self, a: Any) -> Any:
        return [ranges.square(a[0]), *self.convolve([a], [a])[1:]]

    def function(self, name: str, a: Any) -> Any:
        value = getattr(ranges, name)(a[0])
        return self.compose(a, value, *_DERIVATIVES[name](a[0], value))

    def sincos(self, a: Any) -> tuple[Any, Any]:
        sine, cosine = ranges.sincos(a[0])
        return self.compose(a, sine, cosine, -sine), self.compose(a, cosine, -sine, -cosine)

    def compose(self, a: Any, value: Any, first: Any, second: Any) -> Any:
        """Jet of f(a): value f, gradient f' g, Hessian f'' g g' + f' H, for f, f', f'' over the range of a."""
        result = [value] + [None if a[i] is None else first * a[i] for i in self.gradient]
        for entry, i, j in self.hessian:
            bent = None if a[i] is None or a[j] is None else second * (a[i] * a[j])
            result.append(_plus(bent, None if a[entry] is None else first * a[entry]))
        return result

    def value(self, a: Any) -> Any:
        return a[0]

    def jet(self, a: Any) -> Jet:
        return [arb(0)] * self.size if a is None else [arb(0) if x is None else x for x in a]


def _plus(a: Any, b: Any) -> Any:
    return b if a is None else a if b is None else a + b


def _minus(a: Any, b: Any) -> Any:
    return a if b is None else -b if a is None else a - b


def _reciprocal_derivatives(x: Any, value: Any) -> tuple[Any, Any]:
    square = ranges.square(value)
    return -square, 2 * square * value


def _log_derivatives(x: Any, value: Any) -> tuple[Any, Any]:
    inverse = ranges.reciprocal(x)
    return inverse, -ranges.square(inverse)


def _sqrt_derivatives(x: Any, value: Any) -> tuple[Any, Any]:
    # f'' = -1/(4 x^(3/2)) = -f'/(2 x)
    first = ranges.reciprocal(value) / 2
    return first, first * ranges.reciprocal(x) / -2


def _tanh_derivatives(x: Any, value: Any) -> tuple[Any, Any]:
    first = 1 - ranges.square(value)
    return first, -2 * value * first


_DERIVATIVES: dict[str, Callable[[Any, Any], tuple[Any, Any]]] = {
    "exp": lambda x, value: (value, value),
    "reciprocal": _reciprocal_derivatives,
    "log": _log_derivatives,
    "sqrt": _sqrt_derivatives,
    "tanh": _tanh_derivatives,
}
"""f' and f'' over the range x, given the range of f."""
