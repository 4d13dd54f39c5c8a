"""The ONNX operators that are affine in the observation; nothing is rounded, and nothing is composed."""

from __future__ import annotations

import math
from fractions import Fraction

from .convolution import convolution_rows
from .layers import Dense, Diagonal, Layer, Number
from .movements import MAX_NUMBERS
from .onnx_file import Node
from .signals import Operands, Signal, finite, pair, refusal, signal_of, signal_operand, spread


def exact(value: Fraction) -> Number:
    """The same number, as a float where it is one."""
    try:
        near = float(value)
    except OverflowError:
        return value
    return near if Fraction(near) == value else value


def arithmetic(node: Node, operands: Operands) -> Signal:
    """``x + c``, ``x - c``, ``c - x``, ``x c`` or ``x / c`` with a stored array c that does not enlarge x.

    The first addition to a product without offset is its offset: the same function in one layer.
    """
    signal, other, first = pair(node, operands)
    c = spread(finite(node, other, signal.kind), signal.shape)
    zeros, ones = (0.0,) * signal.size, (1.0,) * signal.size
    layers = signal.settled
    match node.operator:
        case "Add":
            last = layers[-1] if layers else None
            if isinstance(last, Dense) and not any(last.offset):
                return signal_of(signal.kind, signal.shape, (*layers[:-1], Dense(last.matrix, c)))
            layer = Diagonal(ones, c)
        case "Sub":
            layer = Diagonal(ones, tuple(-x for x in c)) if first else Diagonal(tuple(-x for x in ones), c)
        case "Mul":
            layer = Diagonal(c, zeros)
        case _:
            if not first or 0 in c:
                raise refusal(node, "divides by the observation, or by zero")
            layer = Diagonal(tuple(exact(1 / Fraction(x)) for x in c), zeros)
    return signal_of(signal.kind, signal.shape, (*layers, layer))


def negation(node: Node, operands: Operands) -> Signal:
    """``-x``."""
    signal = signal_operand(node, operands[0])
    layer = Diagonal((-1.0,) * signal.size, (0.0,) * signal.size)
    return signal_of(signal.kind, signal.shape, (*signal.settled, layer))


def matmul(node: Node, operands: Operands) -> Signal:
    """``y_(..., j) = sum_k x_(..., k) W_(k, j)``: the same matrix for every row of x."""
    signal = signal_operand(node, operands[0])
    weight = finite(node, operands[1], signal.kind)
    if not signal.shape or len(weight.shape) not in (1, 2) or weight.shape[0] != signal.shape[-1]:
        raise refusal(node, f"multiplies values of shape {signal.shape} by a matrix of shape {weight.shape}")
    count = math.prod(weight.shape[1:])
    _require_room(node, signal.size // signal.shape[-1] * count, signal.size)
    columns = [weight.numbers[j::count] for j in range(count)]
    starts = range(0, signal.size, signal.shape[-1])
    matrix = tuple(
        (0.0,) * start + column + (0.0,) * (signal.size - start - len(column)) for start in starts for column in columns
    )
    shape = (*signal.shape[:-1], *weight.shape[1:])
    return signal_of(signal.kind, shape, (*signal.settled, Dense(matrix, (0.0,) * len(matrix))))


def gemm(node: Node, operands: Operands) -> Signal:
    """``alpha x W + beta c`` of a row x, the two factors as a layer of their own where they are not 1."""
    signal = signal_operand(node, operands[0])
    weight = finite(node, operands[1], signal.kind)
    if node.attributes.get("transA", 0) or signal.shape != (1, signal.size) or len(weight.shape) != 2:
        raise refusal(node, f"multiplies values of shape {signal.shape} by a matrix of shape {weight.shape}")
    rows, columns = weight.shape
    transposed = node.attributes.get("transB", 0)
    count, width = (rows, columns) if transposed else (columns, rows)
    if width != signal.size:
        raise refusal(node, f"multiplies values of shape {signal.shape} by a matrix of shape {weight.shape}")
    _require_room(node, count, width)
    numbers = weight.numbers
    matrix = tuple(
        numbers[i * columns : (i + 1) * columns] if transposed else numbers[i::columns] for i in range(count)
    )
    offset = (0.0,) * count
    if len(operands) > 2 and operands[2] is not None:
        offset = spread(finite(node, operands[2], signal.kind), (1, count))
    alpha, beta = (node.attributes.get(name, 1.0) for name in ("alpha", "beta"))
    if not (math.isfinite(alpha) and math.isfinite(beta)):
        raise refusal(node, "has a factor that is not finite")
    layers: tuple[Layer, ...] = (Dense(matrix, offset),)
    if (alpha, beta) != (1.0, 1.0):
        scaled = Diagonal((alpha,) * count, tuple(exact(Fraction(beta) * Fraction(c)) for c in offset))
        layers = (Dense(matrix, (0.0,) * count), scaled)
    return signal_of(signal.kind, (1, count), (*signal.settled, *layers))


def convolve(node: Node, operands: Operands) -> Signal:
    """A convolution of one sample of shape (1, channels, *spatial); see `convolution_rows`."""
    signal = signal_operand(node, operands[0])
    kernel = finite(node, operands[1], signal.kind)
    sizes, rows = convolution_rows(node, kernel, signal.shape)
    offset = (0.0,) * kernel.shape[0]
    if len(operands) > 2 and operands[2] is not None:
        bias = finite(node, operands[2], signal.kind)
        if bias.shape != (kernel.shape[0],):
            raise refusal(node, f"has a bias of shape {bias.shape}")
        offset = bias.numbers
    cells = math.prod(sizes)
    layer = Dense(rows, tuple(number for number in offset for _ in range(cells)))
    return signal_of(signal.kind, (1, kernel.shape[0], *sizes), (*signal.settled, layer))


def _require_room(node: Node, rows: int, columns: int) -> None:
    if not 0 < rows * columns <= MAX_NUMBERS:
        raise refusal(node, f"makes a matrix of {rows} x {columns} numbers")
