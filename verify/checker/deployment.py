"""How far the deployed runtime's arithmetic can be from exact arithmetic on the same numbers: e_L, layer by layer.

With u the unit roundoff, t the smallest normal number of the runtime's precision (what is smaller may be flushed to
zero anywhere), g_k = k u / (1 - k u), x the layer's input, |x| <= size with the error e included, in any order of
summation, with or without fused multiply-add:

    the cast of the observation   u |x| + t
    k products and their sum      |W| (e + t) + g_k (|W| size) + t (k + |size|_1), g_(k+1) and |b| with an offset b
    relu, clip                    e + t
    leaky relu, slope a           max(1, |a|) (e + u size) + t
    tanh, sigmoid                 e max |f'| + the runtime's own error

A stored number that the precision does not have is rounded once more.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .contract import Bounds
from .layers import Activation, Dense, Diagonal, Number, Selection
from .program import ball

Vector: TypeAlias = list[Any]

FORMATS = {"float32": ("<f", 24, -126), "float64": ("<d", 53, -1022)}
"""Struct code, bits of the significand, exponent of the smallest normal number."""


@dataclass(frozen=True)
class Deployment:
    """The error bounds of one runtime.

    Attributes
    ----------
    precision : {"float32", "float64"}
    runtime : ball
        Bound of the error of the runtime's own tanh and sigmoid.
    clip : tuple of (low, high)
        The specification's clip.
    """

    precision: str
    runtime: Any
    clip: tuple[Bounds, ...]

    @cached_property
    def unit(self) -> Any:
        """Unit roundoff u."""
        return arb(2) ** -FORMATS[self.precision][1]

    @cached_property
    def tiny(self) -> Any:
        """Smallest normal number t."""
        return arb(2) ** FORMATS[self.precision][2]

    def start(self, magnitude: Vector) -> Vector:
        """Error of the cast of an observation of at most that magnitude."""
        return [self.unit * size + self.tiny for size in magnitude]

    def through(self, layer: Dense | Diagonal | Selection, magnitude: Vector, error: Vector) -> Vector:
        """Error behind an affine layer whose exact input has at most that magnitude."""
        if isinstance(layer, Selection):
            return [error[i] for i in layer.index]
        size = [a + e for a, e in zip(magnitude, error, strict=True)]
        if isinstance(layer, Diagonal):
            return self._diagonal(layer, size, error)
        constants = _constants(layer, self.precision)
        factor = self._factor(constants.terms)
        each = [e + self.tiny + factor * s for e, s in zip(error, size, strict=True)]
        rounding = (constants.absolute * arb_mat(len(each), 1, each)).entries()
        rest = constants.terms * self.tiny + self.tiny * sum(size, arb(0))
        result = [r + factor * b + rest for r, b in zip(rounding, constants.offset, strict=True)]
        if constants.error is not None:
            wide = [s + e for s, e in zip(size, error, strict=True)]
            more = (constants.error * arb_mat(len(wide), 1, wide)).entries()
            result = [r + m + o for r, m, o in zip(result, more, constants.offset_error, strict=True)]
        return result

    def _diagonal(self, layer: Diagonal, size: Vector, error: Vector) -> Vector:
        result = []
        # onnxruntime may move a factor that is one number into the product beside it, and holds it in float32 there
        one = len(set(layer.scale)) == 1
        for w, b, s, e in zip(layer.scale, layer.offset, size, error, strict=True):
            terms = (w not in (1, -1)) + (b != 0)
            if terms == 0:
                result.append(e)
                continue
            scale, offset = abs(_ball(w)), abs(_ball(b))
            bound = scale * (e + self.tiny) + self._factor(terms) * (scale * s + offset) + self.tiny * (terms + s)
            held = "float32" if one else self.precision
            bound += (s + e) * conversion_error(w, held) + conversion_error(b, self.precision)
            result.append(bound)
        return result

    def _factor(self, terms: int) -> Any:
        """g_k of k roundings."""
        product = terms * self.unit
        return product / (1 - product) if product < arb(1) / 2 else arb.nan()

    def activated(self, activation: Activation, low: Vector, high: Vector, error: Vector) -> Vector:
        """Error behind an activation whose exact input is within [low, high]."""
        if activation.kind in ("relu", "clip"):
            return [e + self.tiny for e in error]
        if activation.kind == "leaky_relu":
            factor = abs(arb(activation.slope)).max(arb(1))
            sizes = [abs(a).max(abs(b)) + e for a, b, e in zip(low, high, error, strict=True)]
            return [factor * (e + self.unit * s) + self.tiny for e, s in zip(error, sizes, strict=True)]
        slopes = [_steepest(activation.kind, a - e, b + e) for a, b, e in zip(low, high, error, strict=True)]
        return [slope * e + self.runtime for slope, e in zip(slopes, error, strict=True)]

    def clip_error(self) -> Vector:
        """Per action: how far the runtime's clip bounds can be from the exact ones."""
        return [
            conversion_error(low, self.precision).max(conversion_error(high, self.precision)) for low, high in self.clip
        ]


def _steepest(kind: str, low: Any, high: Any) -> Any:
    """Upper bound of f' on [low, high]: largest at the point nearest to 0."""
    nearest = low if low > 0 else -high if high < 0 else arb(0)
    value = (nearest if kind == "tanh" else nearest / 2).tanh()
    return (1 - value * value) / (1 if kind == "tanh" else 4)


@dataclass(frozen=True)
class _Constants:
    terms: int
    absolute: Any
    offset: Vector
    error: Any
    offset_error: Vector


@lru_cache(maxsize=256)
def _constants(layer: Dense, precision: str) -> _Constants:
    """Of a layer: summands, |W|, |b|, and the conversion errors of W (None where all are 0) and b."""
    entries = [entry for row in layer.matrix for entry in row]
    shape = len(layer.matrix), len(layer.matrix[0])
    errors = [conversion_error(entry, precision) for entry in (*entries, *layer.offset)]
    converted = any(bool(error != 0) for error in errors)
    return _Constants(
        shape[1] + any(entry != 0 for entry in layer.offset),
        absolute_matrix(layer),
        [abs(_ball(entry)) for entry in layer.offset],
        arb_mat(*shape, errors[: len(entries)]) if converted else None,
        errors[len(entries) :],
    )


@lru_cache(maxsize=256)
def absolute_matrix(layer: Dense) -> Any:
    """|W|."""
    shape = len(layer.matrix), len(layer.matrix[0])
    return arb_mat(*shape, [abs(_ball(entry)) for row in layer.matrix for entry in row])


def _ball(number: Number) -> Any:
    return arb(number) if isinstance(number, float) else ball(Fraction(number))


def conversion_error(number: Number, precision: str) -> Any:
    """Bound of ``|held - number|``, held the runtime's own number: rounded, and flushed to zero where it is tiny."""
    code, bits, least = FORMATS[precision]
    try:
        held = struct.unpack(code, struct.pack(code, float(number)))[0]
    except OverflowError:
        return arb.nan()
    if held == number and (number == 0 or abs(held) >= 2.0**least):
        return arb(0)
    return 2 * abs(_ball(number)) * arb(2) ** -bits + arb(2) ** least
