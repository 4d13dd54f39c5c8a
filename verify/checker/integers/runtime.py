"""How far a runtime's arithmetic can be from exact arithmetic on the same numbers, as integers rounded up.

With u the unit roundoff, t the smallest normal number (what is smaller may be flushed to zero anywhere),
g_k = k u/(1 - k u), x the layer's exact input, |x| <= m, e its error, s = m + e:

    the cast of the observation       u m + t
    y_i = sum of k products + b_i     |W| (e + t) + g (|W| s + |b|) + t (n + |s|_1),
                                      n = k, one more where the layer has an offset; g = g_n
    relu, clip                        e + t
    leaky relu, slope a               max(1, |a|) (e + u s) + t
    tanh, sigmoid                     e max |f'| + the runtime's own error

A stored number w that the precision does not have is within ``2 u |w| + t`` of the runtime's, also where it is rounded
through a longer format. It counts on top: times s + e for a weight, once for an offset. A factor that is one number for
all components may be moved into the product beside it, where onnxruntime holds it in float32 even in float64 networks.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from ..layers import Activation, Dense, Diagonal
from ..rejection import Rejected
from .elementary import tanh
from .fixed import Interval, Matrix, Vector, ceil_at, product_up, shifted_up

FORMATS = {"float32": ("<f", 24, 126), "float64": ("<d", 53, 1022)}
"""Struct code, bits of the significand, minus the exponent of the smallest normal number."""


@dataclass(frozen=True)
class Runtime:
    """One runtime's arithmetic.

    Attributes
    ----------
    precision : {"float32", "float64"}
    own : Fraction
        Bound of the error of its tanh and sigmoid.
    """

    precision: str
    own: Fraction

    @property
    def unit(self) -> Fraction:
        """Unit roundoff u."""
        return Fraction(1, 1 << FORMATS[self.precision][1])

    @property
    def tiny(self) -> Fraction:
        """Smallest normal number t."""
        return Fraction(1, 1 << FORMATS[self.precision][2])

    def cast(self, size: Vector, bits: int) -> Vector:
        """Error of the cast of an observation of at most that size."""
        tiny, places = ceil_at(self.tiny, bits), FORMATS[self.precision][1]
        return [shifted_up(m, places) + tiny for m in size]

    def dense(self, layer: Weights, size: Vector, error: Vector, bits: int) -> Vector:
        """Error behind ``y = W x + b``."""
        g, tiny = ceil_at(layer.growth, bits), ceil_at(self.tiny, bits)
        wide = [m + e for m, e in zip(size, error, strict=True)]
        each = [e + tiny + product_up(g, s, bits) for e, s in zip(error, wide, strict=True)]
        rest = layer.terms * tiny + shifted_up(sum(wide), FORMATS[self.precision][2])
        result = [y + rest for y in layer.matrix.absolute_times(each)]
        if layer.moved is not None:
            more = layer.moved.absolute_times([s + e for s, e in zip(wide, error, strict=True)])
            result = [y + m for y, m in zip(result, more, strict=True)]
        return [y + ceil_at(b, bits) for y, b in zip(result, layer.rest, strict=True)]

    def diagonal(self, layer: Diagonal, size: Vector, error: Vector, bits: int) -> Vector:
        """Error behind ``y_i = w_i x_i + b_i``; a factor of +-1 and an offset of 0 round nothing."""
        result, tiny = [], ceil_at(self.tiny, bits)
        moved = self if len(set(layer.scale)) > 1 else Runtime("float32", self.own)
        for w, b, m, e in zip(layer.scale, layer.offset, size, error, strict=True):
            terms = (w not in (1, -1)) + (b != 0)
            if not terms:
                result.append(e)
                continue
            factor, offset, s = ceil_at(abs(Fraction(w)), bits), ceil_at(abs(Fraction(b)), bits), m + e
            g = ceil_at(self.growth(terms), bits)
            total = product_up(factor, e + tiny, bits)
            total += product_up(g, product_up(factor, s, bits) + offset, bits)
            total += terms * tiny + shifted_up(s, FORMATS[self.precision][2])
            total += product_up(ceil_at(moved.conversion(w), bits), s + e, bits) + ceil_at(self.conversion(b), bits)
            result.append(total)
        return result

    def activated(self, activation: Activation, bounds: Sequence[Interval], error: Vector, bits: int) -> Vector:
        """Error behind an activation whose exact input is within those bounds."""
        tiny = ceil_at(self.tiny, bits)
        if activation.kind in ("relu", "clip"):
            return [e + tiny for e in error]
        if activation.kind == "leaky_relu":
            factor = max(ceil_at(abs(activation.slope), bits), 1 << bits)
            places = FORMATS[self.precision][1]
            sizes = [max(abs(low), abs(high)) + e for (low, high), e in zip(bounds, error, strict=True)]
            return [
                product_up(factor, e + shifted_up(s, places), bits) + tiny for e, s in zip(error, sizes, strict=True)
            ]
        own = ceil_at(self.own, bits)
        return [
            product_up(steepest(activation.kind, low - e, high + e, bits), e, bits) + own
            for (low, high), e in zip(bounds, error, strict=True)
        ]

    def growth(self, terms: int) -> Fraction:
        """g_k of k roundings; `Rejected` where there is no such bound."""
        product = terms * self.unit
        if not product < Fraction(1, 2):
            raise Rejected(f"a sum of {terms} terms in {self.precision} has no error bound")
        return product / (1 - product)

    def holds(self, number: float | Fraction) -> bool:
        """Whether the runtime has exactly this number."""
        code, _, least = FORMATS[self.precision]
        try:
            held: float = struct.unpack(code, struct.pack(code, float(number)))[0]
        except OverflowError:
            raise Rejected(f"a number of the network is too large for {self.precision}") from None
        return held == number and (number == 0 or abs(held) >= 2.0**-least)

    def conversion(self, number: float | Fraction) -> Fraction:
        """Bound of the distance between the runtime's number and the stored one."""
        return Fraction(0) if self.holds(number) else 2 * self.unit * abs(Fraction(number)) + self.tiny


@dataclass(frozen=True, eq=False)
class Weights:
    """A dense layer, and what a runtime's errors of it are made of.

    Attributes
    ----------
    matrix : Matrix
    offset : tuple of float and Fraction
    terms : int
        Summands of one output.
    growth : Fraction
        g of so many terms.
    moved : Matrix or None
        Distances of the runtime's weights from the stored ones; None where there are none.
    rest : list of Fraction
        ``g |b|`` and the distance of the runtime's offset from the stored one.
    """

    matrix: Matrix
    offset: tuple[float | Fraction, ...]
    terms: int = 0
    growth: Fraction = Fraction(0)
    moved: Matrix | None = None
    rest: Sequence[Fraction] = ()

    @classmethod
    def of(cls, layer: Dense, runtime: Runtime | None) -> Weights:
        """Prepare; without a runtime only what exact arithmetic needs."""
        matrix = Matrix.of(layer.matrix)
        if runtime is None:
            return cls(matrix, layer.offset)
        terms = len(layer.matrix[0]) + any(layer.offset)
        growth = runtime.growth(terms)
        moved = [[runtime.conversion(w) for w in row] for row in layer.matrix]
        rest = [growth * abs(Fraction(b)) + runtime.conversion(b) for b in layer.offset]
        return cls(matrix, layer.offset, terms, growth, Matrix.of(moved) if any(map(any, moved)) else None, rest)


def steepest(kind: str, low: int, high: int, bits: int) -> int:
    """Upper bound of the derivative of tanh or sigmoid on an interval: the one at the point nearest to zero.

    ``tanh' = 1 - tanh^2``; ``sigmoid'(x) = (1 - tanh(x/2)^2)/4``.
    """
    nearest = max(low, -high, 0)
    halved = kind == "sigmoid"
    work = bits + halved  # x at `bits` is x/2 at one more
    least, _ = tanh(nearest, work)
    value = shifted_up((1 << 2 * work) - least * least, 2 * work - bits)
    return shifted_up(value, 2) if halved else value
