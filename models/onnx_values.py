"""Symbolic values while an ONNX graph is walked: constants are arrays, everything else is a `Signal`.

A signal is a chain of layers plus an array of positions into the chain's output. Operators that only move numbers
(reshape, transpose, slice, concatenate) act on the positions and cost nothing; the selection becomes a matrix only
where arithmetic follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .policy import Activation, Affine, FloatArray, Layer

Array: TypeAlias = NDArray[Any]

BATCH_ROWS = 3
"""Rows that stand for a dynamic batch: an operator that mixes rows becomes visible in the positions."""

MATRIX_LIMIT = 2**26
"""Largest number of entries of one layer's matrix."""


class Unsupported(Exception):
    """An operator cannot be read; the reader collects these and reports all of them at once."""


@dataclass(frozen=True)
class Signal:
    """A value that depends on the observation.

    Attributes
    ----------
    layers : tuple of Affine and Activation
        What computes the base vector from the observation.
    width : int
        Length of the base vector.
    index : int array of the value's ONNX shape
        Positions in the base vector; with a dynamic batch row b holds positions plus ``b * width``.
    batched : bool
        The first dimension is a dynamic batch, of `BATCH_ROWS` rows here.
    dtype : numpy dtype
        Type in which the file computes this value.
    open_bias : bool
        The last layer is a bare matrix product, whose bias an `Add` may still bring.
    """

    layers: tuple[Layer, ...]
    width: int
    index: Array
    batched: bool
    dtype: np.dtype[Any]
    open_bias: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape without the dynamic batch."""
        return tuple(self.index.shape[self.batched :])

    @property
    def size(self) -> int:
        """Number of components."""
        return int(np.prod(self.shape))


Value: TypeAlias = Signal | Array


def new_signal(
    layers: tuple[Layer, ...], shape: tuple[int, ...], batched: bool, dtype: np.dtype[Any], open_bias: bool = False
) -> Signal:
    """Value of a chain of layers whose output, read in C order, has this shape (without a dynamic batch)."""
    width = int(np.prod(shape))
    rows = BATCH_ROWS if batched else 1
    index = np.arange(rows * width).reshape((rows, *shape) if batched else shape)
    return Signal(layers, width, index, batched, dtype, open_bias)


def moved(signal: Signal, index: Array) -> Signal:
    """The same numbers in another arrangement.

    Raises
    ------
    Unsupported
        The arrangement mixes the rows of a dynamic batch.
    """
    if index.size == 0:
        raise Unsupported("leaves no values")
    if signal.batched:
        rows = index.reshape(index.shape[0], -1) if index.ndim else index
        step = np.arange(BATCH_ROWS)[:, None] * signal.width
        if index.ndim < 1 or index.shape[0] != BATCH_ROWS or (rows != rows[0] + step).any():
            raise Unsupported("mixes the dynamic batch with the values; export with a batch of one")
    unchanged = signal.open_bias and _is_base(index, signal)
    return replace(signal, index=index, open_bias=unchanged)


def _is_base(index: Array, signal: Signal) -> bool:
    first = index[0] if signal.batched else index
    return bool(np.array_equal(first.ravel(), np.arange(signal.width)))


def settled(signal: Signal) -> tuple[Layer, ...]:
    """Layers that compute the signal's components in C order, a selection matrix included where it is needed."""
    if _is_base(signal.index, signal):
        return signal.layers
    first = (signal.index[0] if signal.batched else signal.index).ravel()
    require_matrix(len(first), signal.width)
    matrix = np.zeros((len(first), signal.width))
    matrix[np.arange(len(first)), first] = 1.0
    return (*signal.layers, Affine(matrix, np.zeros(len(first))))


def require_matrix(rows: int, columns: int) -> None:
    """Refuse matrices that would not fit in memory."""
    if rows * columns > MATRIX_LIMIT:
        raise Unsupported(f"needs a matrix of {rows} x {columns} numbers; the limit is {MATRIX_LIMIT} entries")


def require_size(entries: int) -> None:
    """Refuse arrays that would not fit in memory."""
    if entries > MATRIX_LIMIT:
        raise Unsupported(f"makes an array of {entries} entries; the limit is {MATRIX_LIMIT}")


def apply_matrix(signal: Signal, matrix: Array, bias: Array, shape: tuple[int, ...], bare: bool) -> Signal:
    """``y = matrix @ x + bias`` on the components in C order; `shape` is the result's, without a dynamic batch."""
    layer = Affine(np.asarray(matrix, dtype=np.float64), np.asarray(bias, dtype=np.float64))
    return new_signal((*settled(signal), layer), shape, signal.batched, signal.dtype, open_bias=bare)


def apply_scaling(
    signal: Signal, scale: FloatArray, offset: FloatArray, errors: tuple[FloatArray | None, FloatArray | None]
) -> Signal:
    """``y = scale * x + offset`` componentwise; `errors` bound the rounding of scale and offset, None where exact."""
    size = signal.size
    require_matrix(size, size)
    if not (np.isfinite(scale).all() and np.isfinite(offset).all()):
        raise Unsupported("has a constant that overflows")
    scale_error, offset_error = errors
    weight_error = None if scale_error is None or not scale_error.any() else np.diag(scale_error)
    bias_error = None if offset_error is None or not offset_error.any() else offset_error
    layer = Affine(np.diag(scale), offset, weight_error, bias_error)
    return new_signal((*settled(signal), layer), signal.shape, signal.batched, signal.dtype)


def apply_activation(signal: Signal, activation: Activation) -> Signal:
    """The activation on every component."""
    return new_signal((*settled(signal), activation), signal.shape, signal.batched, signal.dtype)


def spread(constant: Array, signal: Signal) -> FloatArray:
    """A constant broadcast against a signal, one float64 per component in C order.

    Raises
    ------
    Unsupported
        The constant is no floating-point array, differs between the rows of the batch or would enlarge the signal.
    """
    if constant.dtype.kind != "f":
        raise Unsupported(f"has a constant of type {constant.dtype}; float32 or float64 is required")
    full = signal.index.shape
    row_constant = not signal.batched or constant.ndim < len(full) or constant.shape[0] == 1
    try:
        enlarged = np.broadcast_shapes(constant.shape, full) != full
    except ValueError:
        enlarged = True
    if enlarged or not row_constant:
        raise Unsupported(f"has a constant of shape {constant.shape} that does not fit values of shape {signal.shape}")
    wide = np.broadcast_to(constant.astype(np.float64), full)
    return np.array(wide[0] if signal.batched else wide, dtype=np.float64).ravel()


def rounding_of(value: FloatArray) -> FloatArray:
    """Upper bound of what one float64 operation rounded away from `value`; round to nearest, underflow included."""
    return np.asarray(np.nextafter(np.abs(value) * 2.0**-53, np.inf) + 2.0**-1074)


def exact_product(left: FloatArray, right: float) -> tuple[FloatArray, FloatArray | None]:
    """``left * right`` and an error bound, None where both factors are float32 numbers and the product is exact."""
    product = np.asarray(left * right)
    with np.errstate(over="ignore"):
        narrow = (left.astype(np.float32) == left).all() and np.float32(right) == right
    return product, None if narrow else np.asarray(np.where(product == 0.0, 2.0**-1074, rounding_of(product)))


def reciprocal(divisor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``1 / divisor`` and an error bound, zero where the divisor is a power of two and its reciprocal is exact."""
    if (divisor == 0.0).any():
        raise Unsupported("divides by zero")
    with np.errstate(over="ignore"):
        value = np.asarray(1.0 / divisor)
    exact = np.abs(np.frexp(divisor)[0]) == 0.5
    return value, np.where(exact & (np.abs(value) >= 2.0**-1022), 0.0, rounding_of(value))
